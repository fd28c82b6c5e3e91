"""Holds what the server asks of the system to the filter of docker/ubbmap.service, which ends in an error where it is too tight.

usage: system_calls.py STAGED WORK
"""

import re
import subprocess
import sys
import time
from pathlib import Path

from image import ROOT

# What systemd's own process calls before the filter is set for the rest.
ALWAYS = {"execve"}


def group(name):
    """The calls of a group, with those of the groups in it."""
    calls = set()
    for line in subprocess.check_output(["systemd-analyze", "syscall-filter", name], text=True).splitlines()[1:]:
        word = line.strip()
        if word.startswith("@"):
            calls |= group(word)
        elif word and not word.startswith("#"):
            calls.add(word)
    return calls


def allowed():
    """The unit's filter: the first line names what is allowed, a line with ~ what is not."""
    calls = set()
    for line in re.findall(r"^SystemCallFilter=(.*)$", (ROOT / "docker/ubbmap.service").read_text(), re.M):
        named = set().union(*(group(word) if word.startswith("@") else {word} for word in line.removeprefix("~").split()))
        calls = calls - named if line.startswith("~") else calls | named
    return calls


def setting(name):
    """The value of a setting that the unit has once."""
    [value] = re.findall(rf"^{name}=(.*)$", (ROOT / "docker/ubbmap.service").read_text(), re.M)
    return value


def main():
    staged, work = Path(sys.argv[1]), Path(sys.argv[2])
    work.mkdir()
    trace = work / "trace"
    binary = staged / "root/usr/local/bin/ubbmap"
    (work / "bin/root/usr/local/bin").mkdir(parents=True)
    # The same run as anywhere else, through a program that watches it.
    watched = work / "bin/root/usr/local/bin/ubbmap"
    watched.write_text(f'#!/bin/sh\nexec strace -D -f -qq -A -o {trace} {binary} "$@"\n')
    watched.chmod(0o755)
    runner = Path(__file__).parent / "run_image.py"
    subprocess.run([sys.executable, runner, "--here", work / "bin", work], check=True, stdout=subprocess.DEVNULL)
    # Two servers and two health checks; the watching programs end a little after them.
    for _ in range(100):
        if trace.read_text().count(" exit_group(0)") >= 4:
            break
        time.sleep(0.1)
    recorded = trace.read_text()
    called = set(re.findall(r"^\d+ +(\w+)\(", recorded, re.M))
    assert {"fdatasync", "accept4"} <= called, f"the recording does not show a server at work: {called}"
    refused = called - allowed() - ALWAYS
    assert not refused, f"the unit's filter refuses {sorted(refused)}"
    families = set(re.findall(r"^\d+ +socket(?:pair)?\((AF_\w+)", recorded, re.M))
    refused = families - set(setting("RestrictAddressFamilies").split())
    assert "AF_INET" in families and not refused, f"the unit refuses sockets of {sorted(refused)}"
    assert setting("MemoryDenyWriteExecute") == "yes"
    both = re.findall(r"^.*PROT_WRITE\|PROT_EXEC.*$", recorded, re.M)
    assert not both, f"the unit refuses memory that is written and executed: {both}"
    print(f"system calls: {len(called)} different ones, all within the unit's filter")


if __name__ == "__main__":
    main()
