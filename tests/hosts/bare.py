"""Run as python -I -S bare.py RESOURCES: the slave without any package but what the FMU brings."""

import importlib
import sys
from pathlib import Path

resources = Path(sys.argv[1])
sys.path.insert(0, str(resources))
stub = importlib.import_module((resources / "slavemodule.txt").read_text().strip())
(slave_type,) = (member for member in vars(stub).values() if isinstance(member, type))
slave = slave_type(instance_name="bare")
slave.setup_experiment(0.0, None, None)
slave.enter_initialization_mode()
slave.exit_initialization_mode()
for step in range(10):
    slave.do_step(step * 0.1, 0.1)
    print(*slave.get_real(sorted(slave.references["Real"])))
