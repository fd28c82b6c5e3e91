"""Takes a guide apart: its files into a folder, and its commands into the file `commands` there.

usage: blocks.py GUIDE.md FOLDER
"""

import re
import sys
from pathlib import Path


def main():
    guide, folder = Path(sys.argv[1]), Path(sys.argv[2])
    commands, block, mark = [], None, None
    for number, line in enumerate(guide.read_text().splitlines(), 1):
        if block is not None:
            if line == "```":
                if mark != "run":
                    (folder / mark).write_text("\n".join(block) + "\n")
                block, mark = None, None
            elif mark != "run":
                block.append(line)
            elif line.startswith("$ "):
                commands.append(line[2:])
            elif commands and commands[-1].endswith("\\"):
                commands.append(line)
        elif line.startswith("```"):
            if mark is None:
                raise SystemExit(f"{guide}:{number}: a block of code that nothing runs")
            block = []
        elif line.strip():
            told = re.fullmatch(r"<!-- (?:run|file: ([\w.-]+)) -->", line)
            if mark is not None:
                raise SystemExit(f"{guide}:{number}: no block of code behind {mark!r}")
            mark = None if told is None else told.group(1) or "run"
    if not commands:
        raise SystemExit(f"{guide}: no commands")
    # Each is shown before it is run.
    shown = []
    for command in commands:
        continued = shown and shown[-1].endswith("\\")
        if not continued:
            quoted = command.replace("'", "'\\''")
            shown.append(f"printf '$ %s\\n' '{quoted}'")
        shown.append(command)
    (folder / "commands").write_text("\n".join(shown) + "\n")


if __name__ == "__main__":
    main()
