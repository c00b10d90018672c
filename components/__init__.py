"""The machines: a folder for each, made of the equations in model.py and the page about them."""

from pathlib import Path

MACHINES = tuple(sorted(model.parent.name for model in Path(__file__).parent.glob("*/model.py")))
