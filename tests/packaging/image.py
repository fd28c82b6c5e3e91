"""The image that docker/Dockerfile describes, read from the Dockerfile itself, in a directory: so what is started is what the file says."""

import ctypes
import json
import os
import re
import shutil
import subprocess
import time
from pathlib import Path

from dockerfile_parse import DockerfileParser

ROOT = Path(__file__).resolve().parent.parent.parent

# What the base image of the last stage holds of libraries.
BASE = "gcr.io/distroless/cc-debian12"
BASE_LIBRARIES = {"libc.so.6", "libm.so.6", "libgcc_s.so.1", "libpthread.so.0", "libdl.so.2", "librt.so.1", "libstdc++.so.6"}
BASE_GLIBC = (2, 36)

PR_SET_NO_NEW_PRIVS = 38


class Recipe:
    """The last stage of the Dockerfile."""

    def __init__(self, path=ROOT / "docker/Dockerfile"):
        with open(path, "rb") as file:
            steps = [step for step in DockerfileParser(fileobj=file).structure if step["instruction"] != "COMMENT"]
        last = max(at for at, step in enumerate(steps) if step["instruction"] == "FROM")
        self.build = steps[:last]
        self.base = steps[last]["value"].split()[0].rsplit(":", 1)[0]
        self.steps = steps[last + 1 :]
        self.environment = dict(re.findall(r"(\w+)=(\S+)", self.one("ENV")))
        self.uid, self.gid = (int(number) for number in self.one("USER").split(":"))
        self.directory = self.one("WORKDIR")
        self.entry = json.loads(self.one("ENTRYPOINT"))
        self.command = json.loads(self.one("CMD"))
        self.volumes = json.loads(self.one("VOLUME"))
        self.health = json.loads(self.one("HEALTHCHECK").split("CMD", 1)[1])

    def one(self, instruction):
        """The value of an instruction that the stage has once."""
        values = [step["value"] for step in self.steps if step["instruction"] == instruction]
        assert len(values) == 1, f"the last stage has {len(values)} of {instruction}, not 1"
        return values[0]

    def copies(self):
        """(from, to, owner) of each COPY; all are from the stage before."""
        for value in (step["value"] for step in self.steps if step["instruction"] == "COPY"):
            flags = dict(re.findall(r"--(\w+)=(\S+)", value))
            source, target = re.sub(r"--\w+=\S+\s*", "", value).split()
            assert flags.pop("from") == "build" and source.startswith("/image/"), value
            owner = tuple(int(number) for number in flags.pop("chown", "0:0").split(":"))
            assert not flags, f"COPY with {flags} is not known here"
            yield source.removeprefix("/image/"), target, owner


def libraries(binary):
    """The shared libraries that a binary asks for, by name and path here; each is in the base image in no older a version."""
    found = dict(re.findall(r"(\S+\.so\.\d+) => (/\S+)", subprocess.check_output(["ldd", binary], text=True)))
    unknown = set(found) - BASE_LIBRARIES
    assert not unknown, f"the base image has no {unknown}"
    symbols = subprocess.check_output(["objdump", "-T", binary], text=True)
    newest = max(tuple(map(int, version.split("."))) for version in re.findall(r"GLIBC_([0-9.]+)", symbols))
    assert newest <= BASE_GLIBC, f"the binary wants glibc {newest}, the base image has {BASE_GLIBC}"
    return found


def lay_out(recipe, staged, target):
    """Puts together under `target` the files of the image: what docker/stage made, and of the base image what the binary needs to start."""
    assert recipe.base == BASE, f"{recipe.base}: say here what that image holds"
    for folder in ("tmp", "proc", "dev", "etc", "lib64"):
        (target / folder).mkdir(parents=True)
    for source, to, owner in recipe.copies():
        to = target / to.lstrip("/")
        shutil.copytree(staged / source, to, dirs_exist_ok=True)
        if os.getuid() == 0:
            for path in [to, *to.rglob("*")] if to != target else []:
                os.chown(path, *owner)
    for path in [*libraries(staged / "root/usr/local/bin/ubbmap").values(), "/lib64/ld-linux-x86-64.so.2"]:
        to = target / path.lstrip("/")
        to.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, to)


class Container:
    """The laid out image with its root read-only, its volume apart, and processes in it under the image's user, without rights.

    Needs to be root, in a mount and a network namespace of its own. What an engine does beyond that (a filter of system calls, limits
    of memory) is not done.
    """

    def __init__(self, recipe, target, volume, environment):
        self.recipe, self.target, self.started = recipe, target, []
        self.environment = {"PATH": "/usr/local/bin:/usr/bin:/bin", **recipe.environment, **environment}
        [mounted] = recipe.volumes
        inside = target / mounted.lstrip("/")
        # As an engine does with a new named volume: content and owner are the directory's.
        if not volume.exists():
            volume.mkdir()
            shutil.copystat(inside, volume)
            owner = inside.stat()
            os.chown(volume, owner.st_uid, owner.st_gid)
        mount("--bind", target, target)
        mount("-o", "remount,bind,ro", target)
        mount("--bind", volume, inside)
        mount("-t", "tmpfs", "-o", "size=64m,mode=1777,noexec,nosuid,nodev", "tmpfs", target / "tmp")
        mount("-t", "proc", "proc", target / "proc")

    def start(self, arguments, **options):
        """A process of the image; `arguments` as in the exec form."""
        libc = ctypes.CDLL(None)

        def confine():
            os.chroot(self.target)
            os.chdir(self.recipe.directory)
            os.setgroups([])
            os.setgid(self.recipe.gid)
            os.setuid(self.recipe.uid)
            libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)

        environment = {**self.environment, **options.pop("environment", {})}
        self.started.append(subprocess.Popen(arguments, preexec_fn=confine, env=environment, text=True, **options))
        return self.started[-1]

    def clear(self):
        """Ends what still runs, so that a check that failed leaves nothing."""
        for process in self.started:
            process.kill()
            process.wait()

    def run(self, arguments):
        """Runs a process to its end: (exit code, what it printed)."""
        process = self.start(arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        printed, _ = process.communicate(timeout=30)
        return process.returncode, printed

    def healthy(self):
        """What the image's health check says."""
        return self.run(self.recipe.health)[0] == 0

    def wait_healthy(self, server):
        """Waits until the health check passes, while the server runs."""
        for _ in range(150):
            assert server.poll() is None, f"the server ended with {server.returncode}"
            if self.healthy():
                return
            time.sleep(0.2)
        raise AssertionError("the health check does not pass")


def mount(*arguments):
    subprocess.run(["mount", *map(str, arguments)], check=True)
