"""The two interpreters of a program agree on its layout: the tables in Python, and loop.c."""

from __future__ import annotations

from pathlib import Path

from cosim.engine import compiler


def test_the_loop_is_compiled_for_every_platform_of_a_release(tmp_path: Path) -> None:
    """Each links against what its system has: what the compiler puts in place of a loop in C must be there, too."""
    compiler.compile_every_loop(tmp_path)
    names = {compiler.file_name(*platform) for platform in compiler.TARGETS}
    assert {path.name for path in tmp_path.iterdir()} == names
