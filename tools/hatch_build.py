"""What an installation has besides its Python: the FMUs, and the master's loop compiled.

Whoever installs from sources builds both, with a compiler that is there only for that: into the wheel, or, where the
installation is editable, into the clone. FMUs in `fmus/` that are up to date are taken as they are. A wheel is for the
machine that makes it, and its name says so; tools/release.py asks for one for all platforms.
"""

import importlib.util
import os
import platform
import subprocess
import sys
import sysconfig
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any
from unittest.mock import patch

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

#: The variable of the environment with which tools/release.py asks for all platforms: "all", else "host".
PLATFORMS = "DRIVE_FMUS_PLATFORMS"
#: The variable with the folder in which the compiler keeps what it has compiled.
KEPT = "ZIG_GLOBAL_CACHE_DIR"


class CustomBuildHook(BuildHookInterface[Any]):
    """Build the FMUs of both flavours and the loops, and put them into the wheel if there is one."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build; raises RuntimeError with the builder's words where an FMU cannot be built."""
        if self.target_name != "wheel":
            return
        root = Path(self.root)
        loops = root / "build" / "loops"
        platforms = os.environ.get(PLATFORMS, "host")
        command = [sys.executable, str(root / "build_fmus.py"), "--flavour", "both"]
        command += ["--platforms", platforms]
        compiler = _compiler(root)
        # what the compiler keeps, 45 MB, goes with the folder
        with (
            TemporaryDirectory(ignore_cleanup_errors=True) as cache,
            patch.dict(os.environ, {KEPT: os.environ.get(KEPT, cache)}),
        ):
            done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(f"the FMUs cannot be built:\n{done.stderr}")
            if version == "editable":
                compiler.compile_loop(compiler.loop_of_sources())
                return
            if platforms == "all":
                compiler.compile_every_loop(loops)
            else:
                compiler.compile_loop(loops / compiler.file_name(sys.platform, platform.machine()))
                tag = sysconfig.get_platform().replace("-", "_").replace(".", "_")
                build_data["pure_python"], build_data["tag"] = False, f"py3-none-{tag}"
        fmus = [
            path
            for pattern in ("*.fmu", "native/*.fmu", "wasm/*.wasm")
            for path in sorted((root / "fmus").glob(pattern))
        ]
        included = build_data["force_include"]
        for path in fmus:
            if path.name != "LinearSystem.fmu":  # no question uses it
                included[str(path)] = f"scenarios/fmus/{path.relative_to(root / 'fmus').as_posix()}"
        for path in sorted(loops.glob("*.so")):
            included[str(path)] = f"cosim/engine/compiled/{path.name}"
        for path in sorted((root / "components").glob("*/*")):
            if path.suffix in (".py", ".md", ".svg") and path.name != "__init__.py":
                member = path.relative_to(root / "components").as_posix()
                included[str(path)] = f"fmukit/machines/{member}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the compiled loops, which are in the wheel now."""
        rmtree(Path(self.root) / "build" / "loops", ignore_errors=True)


def _compiler(root: Path) -> ModuleType:
    """The module that compiles the loop, without the package around it, which needs more than a build."""
    path = root / "cosim" / "engine" / "compiler.py"
    spec = importlib.util.spec_from_file_location("loop_compiler", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
