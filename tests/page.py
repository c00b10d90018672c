"""Run the blocks of a page in order: JSON [[language, place, text], ...] on stdin.

Blocks of Python share their names. What is not python or sh is the path of a file to write.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any


def main() -> None:
    names: dict[str, Any] = {"__name__": "page"}
    sys.path.insert(0, "")
    for language, label, text in json.load(sys.stdin):
        print(f"--- {label}", flush=True)
        if language == "python":
            exec(compile(text, label, "exec"), names)  # noqa: S102
        elif language == "sh":
            shell = ["bash", "-e", "-o", "pipefail", "-c"]
            subprocess.run([*shell, text], check=True, stdin=subprocess.DEVNULL)
        else:
            Path(language).parent.mkdir(parents=True, exist_ok=True)
            Path(language).write_text(text)


if __name__ == "__main__":
    main()
