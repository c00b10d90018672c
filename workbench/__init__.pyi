from .answer import Answer as Answer
from .answer import Findings as Findings
from .answer import Show as Show
from .answer import Table as Table
from .charts.model import Chart as Chart
from .charts.model import Curve as Curve
from .charts.model import Mark as Mark
from .charts.model import Panel as Panel
from .context import Context as Context
from .figure import Figure as Figure
from .find import Find as Find
from .judgement import Judgement as Judgement
from .live import Number as Number
from .live import Reader as Reader
from .live import RunChart as RunChart
from .live import RunPanel as RunPanel
from .live import Slider as Slider
from .options import Options as Options
from .options import RunOptions as RunOptions
from .options import option as option
from .plan import Plan as Plan
from .plan import PlanQuestion as PlanQuestion
from .question import Question as Question

THREADS: tuple[str, ...]
