"""Builds the image and runs it, on a machine without a Docker engine and without a container registry.

The base image of the Dockerfile cannot be fetched there. A **stand-in** under the real name `python:3.13-slim` is made
of Debian packages instead: it has the name, a `python` and not the contents. What these tests say of the image is said
of the Dockerfile's own layers; whether the official image brings a compiler or a fault is not established here.

buildah and podman want cgroup v2 alone and mounts of their own: everything runs in a private mount namespace.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robot-gateway-tests" / "container"
TOOLS = ("unshare", "nsenter", "mmdebstrap", "buildah", "podman", "crun")
SUITE, PYTHON = "trixie", "3.13"
BASE = f"docker.io/library/python:{PYTHON}-slim"
IMAGE = "localhost/robot-gateway:test"
STAGE_ONE = "localhost/robot-gateway-build:test"
_PACKAGES = "python3,python3-venv,ca-certificates"
_BASE_FILE = f"""\
FROM scratch
ADD base.tar /
RUN rm -rf /var/lib/apt/lists/* && ln -s /usr/bin/python{PYTHON} /usr/local/bin/python
ENV PATH=/usr/local/bin:/usr/local/sbin:/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8
"""
_NAMESPACE = "umount -R /sys/fs/cgroup; mount -t cgroup2 none /sys/fs/cgroup && echo ready && exec cat"
# What this kind of machine needs besides what a page of ours says.
_RUN = ("--cgroups=disabled", "--ulimit=nofile=4096:4096", "--ulimit=nproc=4096:4096", "--read-only-tmpfs=false")
_BUNDLE = Path("/etc/ssl/certs/ca-certificates.crt")
_ASK = """\
import json, ssl, sys, urllib.error, urllib.request
url, headers = sys.argv[1], json.loads(sys.argv[2])
own = ssl.create_default_context()
own.check_hostname, own.verify_mode = False, ssl.CERT_NONE
opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), urllib.request.HTTPSHandler(context=own))
try:
    answer = opener.open(urllib.request.Request(url, headers=headers), timeout=5)
except urllib.error.HTTPError as error:
    answer = error
print(json.dumps([answer.status, answer.read().decode()]))
"""
_READ = "import sys, urllib.request as r; s = r.urlopen(sys.argv[1]); print('on', flush=True); s.read()"


@dataclass(frozen=True, slots=True)
class Done:
    """How a command ended.

    Attributes:
        code: Its exit code.
        out: What it wrote to stdout.
        err: The same of stderr.
    """

    code: int
    out: str
    err: str


def run(*command: str, timeout_s: float = 20) -> Done:
    """Run a command of this machine to its end."""
    done = subprocess.run(  # noqa: S603
        command, capture_output=True, text=True, timeout=timeout_s, check=False, cwd="/", stdin=subprocess.DEVNULL
    )
    return Done(done.returncode, done.stdout, done.stderr)


def reason_to_skip() -> str | None:
    """Why no container can be built and run here; None: one can."""
    if os.geteuid() != 0:
        return "needs root: mount namespaces and image layers"
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        return f"needs {', '.join(missing)}: apt-get install buildah podman crun fuse-overlayfs mmdebstrap"
    tried = run("unshare", "--mount", "true")
    return f"needs mount namespaces: {tried.err.strip()}" if tried.code else None


@dataclass(frozen=True, slots=True)
class Engine:
    """Builds images into the cache, and runs containers whose every trace is in a folder of this session.

    Attributes:
        holder: Process id of who holds the mount namespace.
        cache: Where the images are kept.
        folder: Of this session.
    """

    holder: int
    cache: Path
    folder: Path

    def podman(self, *arguments: str, timeout_s: float = 60) -> Done:
        """Run podman; what it complains of this machine (no systemd, no bridge) is left out."""
        return self._run(
            "podman",
            *(f"--root={self.folder}/root", f"--runroot={self.folder}/run", f"--tmpdir={self.folder}/libpod"),
            *("--storage-driver=overlay", f"--storage-opt=additionalimagestore={self.cache}/images"),
            *("--runtime=crun", "--cgroup-manager=cgroupfs", "--events-backend=file"),
            *arguments,
            timeout_s=timeout_s,
        )

    def buildah(self, *arguments: str) -> str:
        """Run buildah.

        Raises:
            RuntimeError: It failed; the text is the end of what it wrote.
        """
        store = (f"--root={self.cache}/images", f"--runroot={self.folder}/buildah", "--storage-driver=overlay")
        done = self._run("buildah", *store, *arguments, timeout_s=280)
        if done.code:
            raise RuntimeError(f"buildah {arguments[0]}: {(done.out + done.err)[-4000:]}")
        return done.out

    def _run(self, *command: str, timeout_s: float) -> Done:
        enter = ("nsenter", f"--mount=/proc/{self.holder}/ns/mnt", "--wd=/", "--")
        done = run(*enter, *command, timeout_s=timeout_s)
        told = [line for line in done.err.splitlines() if not line.startswith("time=")]
        return Done(done.code, done.out, "\n".join(told))

    def build(self) -> None:
        """Make the stand-in unless the cache has it, and the image with the Dockerfile of this checkout."""
        if BASE not in self.buildah("images", "--format={{.Name}}:{{.Tag}}"):
            self._make_base()
        pip_conf = self.folder / "pip.conf"
        pip_conf.write_text(f"[global]\ncert = {_BUNDLE}\n" if _BUNDLE.exists() else "")
        common = [
            *("bud", "--isolation=chroot", "--format=docker", "--pull-never", "--network=host", "--layers"),
            *(f"--volume={_BUNDLE.parent}:{_BUNDLE.parent}:ro", f"--volume={pip_conf}:/etc/pip.conf:ro"),
            *(f"--build-arg=PYTHON={PYTHON}", "--build-arg=VERSION=0.0.0-test"),
        ]
        self.buildah(*common, "--target=build", f"--tag={STAGE_ONE}", str(ROOT))  # named, or pruning would take it
        self.buildah(*common, f"--tag={IMAGE}", str(ROOT))
        self.buildah("rmi", "--prune", "--force")

    def _make_base(self) -> None:
        context = self.folder / "base"
        context.mkdir()
        (context / "Dockerfile").write_text(_BASE_FILE)
        lean = [f"--dpkgopt=path-exclude=/usr/share/{name}/*" for name in ("doc", "man", "locale")]
        make = ["mmdebstrap", "--variant=minbase", f"--include={_PACKAGES}", *lean, SUITE, str(context / "base.tar")]
        done = self._run(*make, timeout_s=280)
        if done.code:
            raise RuntimeError(f"mmdebstrap: {done.err[-4000:]}")
        self.buildah("bud", "--isolation=chroot", "--format=docker", "--pull-never", f"--tag={BASE}", str(context))
        shutil.rmtree(context)

    def once(self, *arguments: str, options: Sequence[str] = ()) -> Done:
        """Run a container with a command of the gateway until it ends."""
        return self.podman("run", "--rm", "--network=none", *_RUN, *options, IMAGE, *arguments)

    @contextmanager
    def running(self, options: Sequence[str]) -> Iterator[Container]:
        """Run a container for as long as the context lasts, in a network of its own that has nothing but loopback."""
        started = self.podman("run", "--detach", "--network=none", *_RUN, *options, IMAGE)
        if started.code:
            raise RuntimeError(f"podman run: {started.err}")
        name = started.out.strip()
        try:
            process = int(self.podman("inspect", "--format={{.State.Pid}}", name).out)
            yield Container(self, name, process)
        finally:
            self.podman("rm", "--force", "--time=0", name)


@dataclass(frozen=True, slots=True)
class Container:
    """A running container.

    Attributes:
        engine: What runs it.
        name: Its id.
        process: Process id, outside of it, of its process 1.
    """

    engine: Engine
    name: str
    process: int

    def get(self, path: str, headers: Mapping[str, str] | None = None, url: str = "http://127.0.0.1:8765") -> Answer:
        """Ask its gateway from inside its network."""
        done = run(*self._inside, _ASK, url + path, json.dumps(dict(headers or {})))
        if done.code:
            raise RuntimeError(done.err.splitlines()[-1] if done.err else "no answer")
        status, text = json.loads(done.out)
        return Answer(status, text)

    @contextmanager
    def reading(self, path: str) -> Iterator[subprocess.Popen[str]]:
        """Read an answer to its end in a process of its own, whose exit code says whether it had one."""
        words = (*self._inside, _READ, f"http://127.0.0.1:8765{path}")
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as reader:  # noqa: S603
            if reader.stdout is None or reader.stdout.readline() != "on\n":
                raise RuntimeError(f"{path} does not answer")
            yield reader

    @property
    def _inside(self) -> tuple[str, ...]:
        """Runs a Python program in its network, with nothing else of it."""
        return ("nsenter", f"--net=/proc/{self.process}/ns/net", "--", sys.executable, "-c")

    def healthy(self) -> bool:
        """What the image's HEALTHCHECK says."""
        return self.engine.podman("healthcheck", "run", self.name).code == 0

    def execute(self, *command: str) -> Done:
        """Run a command in it."""
        return self.engine.podman("exec", self.name, *command)

    def logs(self) -> str:
        """What it has written, stdout and stderr."""
        done = self.engine.podman("logs", self.name)
        return done.out + done.err

    def signal(self, name: str) -> None:
        """Send a signal to its process 1."""
        self.engine.podman("kill", f"--signal={name}", self.name)

    def stop(self, within_s: int) -> int:
        """Stop it as `docker stop` does: its STOPSIGNAL, and after a while SIGKILL; its exit code, 137 if killed."""
        self.engine.podman("stop", f"--time={within_s}", self.name)
        return int(self.engine.podman("inspect", "--format={{.State.ExitCode}}", self.name).out)


@dataclass(frozen=True, slots=True)
class Answer:
    """An HTTP answer."""

    status: int
    text: str


@contextmanager
def engine(folder: Path) -> Iterator[Engine]:
    """Have the image built, and run containers of it; at the end nothing is left but the cache.

    Args:
        folder: An empty folder of this session.
    """
    recipe = hashlib.sha256(f"{SUITE} {_PACKAGES} {_BASE_FILE}".encode()).hexdigest()[:12]
    cache = CACHE / recipe
    cache.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        lock = stack.enter_context((cache / "lock").open("w"))
        fcntl.flock(lock, fcntl.LOCK_EX)  # one session builds at a time, and none while another runs what is built
        holder = stack.enter_context(_mount_namespace())
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        made = Engine(holder, cache, folder)
        made.build()
        fcntl.flock(lock, fcntl.LOCK_SH)
        yield made


@contextmanager
def _mount_namespace() -> Iterator[int]:
    """The id of a process in a mount namespace of its own; it ends with this process, whatever becomes of that."""
    with subprocess.Popen(  # noqa: S603
        [shutil.which("unshare") or "unshare", "--mount", "--propagation=private", "bash", "-c", _NAMESPACE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd="/",
    ) as holder:
        if holder.stdout is None or holder.stdout.readline() != b"ready\n":
            raise RuntimeError("cgroup v2 cannot be mounted here")
        yield holder.pid


def within(seconds: float, holds: Callable[[], bool]) -> bool:
    """Whether something comes to hold in time."""
    end = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(0.1)
    return True
