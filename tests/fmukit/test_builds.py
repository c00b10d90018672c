"""Builds: for the platforms that are asked for, whole files or none, and nothing left behind."""

import os
import re
import shutil
import signal
import stat
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fmukit.fmu import make, validate
from fmukit.fmu.native import package
from fmukit.fmu.workplace import OWNER, PREFIX, workplace
from tests.conftest import ROOT, restore_ctrl_c, rewritten, running, until

MODEL = ROOT / "tests" / "fmukit" / "models" / "gain.py"
FILES = ("Gain.fmu", "native/Gain.fmu", "wasm/Gain.wasm")
HOST_LIBRARY = f"binaries/{package.HOST[0]}/Gain.{package.EXTENSIONS.get(package.HOST[0], 'so')}"
#: A compiler that waits for ever, and has a child that does so, as Zig has.
ENDLESS = (
    "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import time; time.sleep(600)'])"
)


@pytest.fixture
def fake_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a compiler writes is its target and the options, at once; nothing can be played."""

    def compiled(target: str, source: str, output: str, folder: Path, options: list[str]) -> bytes:
        return b"\xcf\xfa\xed\xfe\x07\0\0\1\3\0\0\0" + repr((target, output, *options)).encode()

    monkeypatch.setattr(package, "run_compiler", compiled)
    monkeypatch.setattr(package, "WASM_HEADERS", ())
    monkeypatch.setattr(package, "MUSL_MATH", ())
    monkeypatch.setattr(validate, "differences_from_reference", lambda _: [])


def build(out: Path, platforms: str = "host", flavour: str = "native") -> dict[str, bool]:
    """Which files of the model were built, by their labels; the others were up to date."""
    outcomes: list[make.Outcome] = []
    assert not make.make_all([MODEL], flavour, out, False, platforms, outcomes.append)
    return {made.label: made.is_new for outcome in outcomes for made in outcome.made}


def members(fmu: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def guid(fmu: Path) -> str:
    (found,) = re.findall(
        rb'(?:guid|instantiationToken)="([^"]*)"', members(fmu)["modelDescription.xml"]
    )
    return str(found, "utf-8")


@pytest.mark.parametrize(("flavour", "count"), [("native", 4), ("fmi3", 5)])
def test_fmus_for_this_machine_and_for_all_are_told_apart(
    flavour: str, count: int, tmp_path: Path, fake_compiler: None
) -> None:
    """The same source and platforms give the same bytes, all platforms the same GUID."""
    fmu = tmp_path / flavour / "Gain.fmu"
    label = f"{flavour}/Gain.fmu"
    assert build(tmp_path, "host", flavour)[label]
    assert not build(tmp_path, "host", flavour)[label]
    host = fmu.read_bytes(), guid(fmu), {name for name in members(fmu) if "binaries/" in name}
    assert len(host[2]) == 1
    assert build(tmp_path, "all", flavour)[label]
    everywhere = fmu.read_bytes()
    assert len({name for name in members(fmu) if "binaries/" in name}) == count
    assert guid(fmu) == host[1]
    assert not build(tmp_path, "all", flavour)[label]
    assert not build(tmp_path, "host", flavour)[label]
    assert fmu.read_bytes() == everywhere
    fmu.unlink()
    build(tmp_path, "host", flavour)
    assert fmu.read_bytes() == host[0]


@pytest.mark.slow
def test_libraries_for_all_platforms_are_of_their_kind(tmp_path: Path) -> None:
    build(tmp_path, "all")
    actual = members(tmp_path / "native" / "Gain.fmu")
    for place, beginning in {
        "linux64/Gain.so": b"\x7fELF\2\1\1",
        "aarch64-linux/Gain.so": b"\x7fELF\2\1\1",
        "win64/Gain.dll": b"MZ",
        "darwin64/Gain.dylib": b"\xca\xfe\xba\xbe\0\0\0\2",
    }.items():
        assert actual[f"binaries/{place}"].startswith(beginning)
    machines = {actual[f"binaries/{p}/Gain.so"][18] for p in ("linux64", "aarch64-linux")}
    assert machines == {0x3E, 0xB7}


def empty_members(files: dict[str, Any]) -> None:
    """All members but the description are empty, with a right checksum each."""
    files.update({name: b"" for name in files if name != "modelDescription.xml"})


def replace_members(fmu: Path, edit: Callable[[dict[str, Any]], Any]) -> None:
    rewritten(fmu, fmu.with_suffix(".new"), edit).replace(fmu)


def cut_end(file: Path, count: int) -> None:
    file.write_bytes(file.read_bytes()[:-count])


def zero_block(file: Path) -> None:
    """A block that never reached the disk, as after a loss of power."""
    content = bytearray(file.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 512] = bytes(512)
    file.write_bytes(content)


def without_code(files: dict[str, Any]) -> None:
    files["binaries/linux64/Gain.so"] = files.pop(HOST_LIBRARY)[:-1]


DAMAGES: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "empty members": (FILES[1], lambda file: replace_members(file, empty_members)),
    "a library that is cut off": (FILES[1], lambda file: replace_members(file, without_code)),
    "no library": (FILES[1], lambda file: replace_members(file, lambda f: f.pop(HOST_LIBRARY))),
    "broken XML": (
        FILES[1],
        lambda file: replace_members(
            file, lambda f: f.update({"modelDescription.xml": b"<fmiModel"})
        ),
    ),
    "an FMU that is cut off": (FILES[0], lambda file: cut_end(file, 100)),
    "an FMU with zeros": (FILES[1], zero_block),
    "a module that is cut off": (FILES[2], lambda file: cut_end(file, 2000)),
    "a module with zeros": (FILES[2], zero_block),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the compiler has made of the model, by its target."""
    return tmp_path_factory.mktemp("made")


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_built_again(
    damage: str, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compile_c = package.run_compiler

    def compile_once(target: str, source: str, output: str, *more: Any) -> bytes:
        kept = made / f"{target}.{output}"
        if not kept.exists():
            kept.write_bytes(compile_c(target, source, output, *more))
        return kept.read_bytes()

    monkeypatch.setattr(package, "run_compiler", compile_once)
    assert all(build(tmp_path, flavour="both").values())
    assert not any(build(tmp_path, flavour="both").values())
    name, hurt = DAMAGES[damage]
    whole = (tmp_path / name).read_bytes()
    hurt(tmp_path / name)
    assert build(tmp_path, flavour="both") == {file: file == name for file in FILES}
    assert (tmp_path / name).read_bytes() == whole


def test_a_file_that_cannot_be_written_is_named_and_stops_no_other(
    tmp_path: Path, fake_compiler: None, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "native" / "Gain.fmu").mkdir(parents=True)
    other = MODEL.with_name("van_der_pol.py")
    assert len(make.make_all([MODEL, tmp_path / "nothing.py", other], "both", tmp_path)) == 2
    errors = capsys.readouterr().err.splitlines()
    assert errors == [
        f"{tmp_path}/native/Gain.fmu cannot be written: Is a directory: {errors[0].rpartition(': ')[2]}",
        f"there is no file {tmp_path}/nothing.py",
    ]
    assert {path.name for path in tmp_path.rglob("*.*")} >= {
        "Gain.wasm", "VanDerPol.fmu", "VanDerPol.wasm"
    }  # fmt: skip
    assert not [*tmp_path.rglob(f"{PREFIX}*")]


def test_folders_of_builds_that_have_ended_go_and_no_others(tmp_path: Path) -> None:
    """With an owner that ended, or empty since a build was killed before it was their owner."""
    ended, empty, mine = (
        tmp_path / f"{PREFIX}{name}" for name in ("ownedone", "emptyone", "plans")
    )
    for folder in (ended, empty, mine):
        folder.mkdir()
    for file in (ended / OWNER, ended / "Gain.c", mine / "plan.txt"):
        file.touch()
    (tmp_path / f"{PREFIX}linklink").symlink_to(ended)
    with workplace(tmp_path) as lives:
        assert not ended.exists() and not empty.exists()
        with workplace(tmp_path) as other:
            assert lives.is_dir()
            assert other != lives
        assert lives.is_dir()
        assert stat.S_IMODE(lives.stat().st_mode) == 0o700
    assert not lives.exists()
    assert (mine / "plan.txt").is_file() and (tmp_path / f"{PREFIX}linklink").is_symlink()


def test_what_a_compiler_writes_while_its_build_ends_goes_with_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def removed_and_written(folder: Path, ignore_errors: bool) -> None:
        shutil.rmtree(folder, ignore_errors)
        (folder / "zig").mkdir(parents=True)

    with monkeypatch.context() as context:
        context.setattr("fmukit.fmu.workplace.rmtree", removed_and_written)
        with workplace(tmp_path) as ended:
            pass
    assert (ended / "zig").is_dir()
    with workplace(tmp_path):
        assert not ended.exists()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are looked for in /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_build_that_is_ended_takes_its_compilers_with_it(
    number: signal.Signals, tmp_path: Path
) -> None:
    """A compiler that never ends, with a child of its own, in two processes of one build."""
    package_of_zig = tmp_path / "path" / "ziglang"
    package_of_zig.mkdir(parents=True)
    (package_of_zig / "__main__.py").write_text(ENDLESS)
    (package_of_zig / "__init__.py").touch()
    out, mark = tmp_path / "out", f"mark-{os.getpid()}-{number.name}"
    models = [MODEL, MODEL.with_name("van_der_pol.py")]
    process = subprocess.Popen(
        [sys.executable, "-m", "fmukit", "build", *models, "--flavour", "native", "--out", out],
        env=os.environ | {"PYTHONPATH": f"{package_of_zig.parent}:{ROOT}", "MARK": mark},
        preexec_fn=restore_ctrl_c, stderr=subprocess.PIPE, text=True,  # noqa: PLW1509
    )  # fmt: skip
    until(
        lambda: sum("time.sleep" in line for line in running(mark)) >= min(2, os.cpu_count() or 1)
    )
    process.send_signal(number)
    _, message = process.communicate()
    until(lambda: not running(mark))
    left = [*out.glob(f"{PREFIX}*")]
    if number == signal.SIGKILL:
        assert (process.returncode, len(left)) == (-9, 1)
        with workplace(out):
            assert not left[0].exists()
    else:
        assert (process.returncode, left) == (130, [])
        assert message == "interrupted; what was built stays, and the same command continues\n"


def test_a_process_that_is_killed_ends_the_build_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the system does for want of memory; a pool would wait for ever."""

    def killed(*_: Any) -> bytes:
        os.kill(os.getpid(), signal.SIGKILL)
        return b""

    monkeypatch.setattr(package, "run_compiler", killed)
    assert len(make.make_all([MODEL], "native", tmp_path)) == 1
    message = capsys.readouterr().err
    assert "a process of the build was killed" in message
    assert len(message.splitlines()) == 1
    assert not [*tmp_path.glob(f"{PREFIX}*")]
