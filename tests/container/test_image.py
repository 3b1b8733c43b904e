"""The image of the Dockerfile, built here on a stand-in for its base (see kit.py), and run as the pages say."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.container.kit import IMAGE, ROOT, Answer, Container, Engine, engine, reason_to_skip, run, within
from tests.container.pages import compose_options, run_options

pytestmark = [
    pytest.mark.limit(280),  # the first of them builds base and image
    pytest.mark.skipif(reason_to_skip() is not None, reason=str(reason_to_skip())),
]
TOKEN = "rgw_" + "Aa0-" * 10 + "zzz"  # of nobody
BEARER = {"Authorization": f"Bearer {TOKEN}"}
TOKENS = f'[[tokens]]\nname = "anna"\nsha256 = "{hashlib.sha256(TOKEN.encode()).hexdigest()}"\n'
ROBOT = '[[robots]]\nname = "{}"\nvendor = "rainbow"\nhost = "127.0.0.2"\n'
OPEN = '[server]\nlisten = "0.0.0.0:8765"\n'


@pytest.fixture(scope="module")
def docker() -> Iterator[Engine]:
    # podman takes no path of more than 50 characters for what it runs: pytest's own folders may be longer
    with (
        tempfile.TemporaryDirectory(prefix="rgw-", ignore_cleanup_errors=True) as folder,
        engine(Path(folder)) as made,
    ):
        yield made


@pytest.fixture(scope="module")
def shared(docker: Engine, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Container]:
    """A container as compose.yaml runs it, for the tests that only look."""
    with docker.running(compose_options(cell(tmp_path_factory.mktemp("cell")))) as container:
        assert within(20, container.healthy), container.logs()
        yield container


def cell(folder: Path) -> Path:
    """The folder that the page has people make: the example's configuration as it is, and a file of tokens."""
    (folder / "gateway").mkdir()
    example = (ROOT / "config" / "docker" / "gateway" / "gateway.toml").read_text("utf-8")
    (folder / "gateway" / "gateway.toml").write_text(example.replace("10.0.2.7", "127.0.0.1"))
    (folder / "tokens.toml").write_text(TOKENS)
    return folder


def with_config(folder: Path, text: str) -> list[str]:
    """Options that mount a folder with a configuration."""
    cell(folder)
    (folder / "gateway" / "gateway.toml").write_text(text)
    return [f"--volume={folder}/gateway:/etc/robot-gateway:ro"]


def test_the_container_of_the_compose_file_becomes_healthy(shared: Container) -> None:
    assert shared.healthy()
    assert shared.get("/healthz").status == 200
    assert within(10, lambda: shared.get("/readyz").status == 200)


def test_the_container_of_the_page_becomes_healthy(docker: Engine, tmp_path: Path) -> None:
    with docker.running(run_options(cell(tmp_path))) as container:
        assert within(20, container.healthy), container.logs()
        assert container.stop(within_s=2) == 0


def test_metrics_need_a_token(shared: Container) -> None:
    refused = shared.get("/metrics")
    assert (refused.status, json.loads(refused.text)["code"]) == (401, "UNAUTHORIZED")
    assert shared.get("/metrics", {"Authorization": "Bearer rgw_" + "b" * 43}).status == 401
    told = shared.get("/metrics", BEARER)
    assert told.status == 200
    assert "robot_gateway_info" in told.text


@pytest.mark.skipif(shutil.which("ip") is None, reason="needs ip: apt-get install iproute2")
def test_on_an_address_of_the_network_it_answers_as_on_loopback(shared: Container) -> None:
    added = run(
        "nsenter", f"--net=/proc/{shared.process}/ns/net", "ip", "address", "add", "198.51.100.2/32", "dev", "lo"
    )
    assert added.code == 0, added
    url = "http://198.51.100.2:8765"
    assert shared.get("/healthz", url=url).status == 200
    assert shared.get("/api/v1/robots", url=url).status == 401
    assert shared.get("/api/v1/robots", BEARER, url=url).status == 200


def test_it_runs_without_root_capabilities_and_new_privileges(shared: Container) -> None:
    lines = Path(f"/proc/{shared.process}/status").read_text().splitlines()
    status = dict(line.split(":\t", 1) for line in lines if ":\t" in line)
    assert set(status["Uid"].split() + status["Gid"].split()) == {"10001"}
    assert {status[name] for name in ("CapEff", "CapPrm", "CapBnd")} == {"0" * 16}
    assert status["NoNewPrivs"] == "1"


def test_nothing_but_the_folder_of_the_control_socket_can_be_written(shared: Container) -> None:
    mounts = Path(f"/proc/{shared.process}/mounts").read_text().splitlines()
    root = next(line.split() for line in mounts if line.split()[1] == "/")
    assert "ro" in root[3].split(",")
    assert shared.execute("touch", "/run/robot-gateway/x").code == 0
    for folder in ("/var/tmp", "/etc/robot-gateway", "/run", "/opt/robot-gateway"):  # noqa: S108
        assert shared.execute("touch", f"{folder}/x").code != 0, folder


def test_the_gateway_is_process_1_and_no_shell_stands_in_between(shared: Container) -> None:
    words = Path(f"/proc/{shared.process}/cmdline").read_bytes().split(b"\0")
    assert words[-3:-1] == [b"/opt/robot-gateway/bin/robot-gateway", b"run"]


def test_the_logs_are_json_and_tell_no_token(docker: Engine, tmp_path: Path) -> None:
    wrong = "rgw_" + "c" * 43
    with docker.running(compose_options(cell(tmp_path))) as container:
        assert within(20, container.healthy), container.logs()
        assert container.get("/metrics", BEARER).status == 200
        assert container.get(f"/metrics?token={TOKEN}").status == 200
        assert container.get(f"/metrics?token={wrong}").status == 401
        assert container.get("/api/v1/robots", {"Authorization": f"Bearer {wrong}"}).status == 401
        logs = container.logs()
    assert TOKEN not in logs
    assert wrong not in logs
    said = [line for line in logs.splitlines() if not line.startswith("warning: /etc/robot-gateway/")]
    assert said
    assert all(json.loads(line)["event"] for line in said)


def test_sigterm_ends_it_in_two_seconds_even_while_somebody_reads(docker: Engine, tmp_path: Path) -> None:
    with docker.running(compose_options(cell(tmp_path))) as container:
        assert within(20, container.healthy), container.logs()
        with container.reading(f"/api/v1/stream?topics=*&token={TOKEN}") as reader:
            begun = time.monotonic()
            code = container.stop(within_s=2)  # past these it is killed, and the code is 137
            print(f"stopped in {time.monotonic() - begun:.2f} s")
            assert code == 0
            assert reader.wait(timeout=10) == 0


def test_sighup_reloads(docker: Engine, tmp_path: Path) -> None:
    def robots() -> Answer:
        return container.get("/api/v1/robots", BEARER)

    with docker.running(compose_options(cell(tmp_path))) as container:
        assert within(20, container.healthy), container.logs()
        with (tmp_path / "gateway" / "gateway.toml").open("a") as file:
            file.write(ROBOT.format("cell2"))
        container.signal("HUP")
        assert within(10, lambda: '"cell2"' in robots().text), container.logs()


def test_a_command_in_the_container_reloads_and_tells_the_difference(docker: Engine, tmp_path: Path) -> None:
    with docker.running(compose_options(cell(tmp_path))) as container:
        assert within(20, container.healthy), container.logs()
        with (tmp_path / "gateway" / "gateway.toml").open("a") as file:
            file.write(ROBOT.format("cell2"))
        checked = container.execute("robot-gateway", "reload", "--check")
        assert checked.code == 0, checked
        assert "cell2" in checked.out
        assert '"cell2"' not in container.get("/api/v1/robots", BEARER).text
        done = container.execute("robot-gateway", "reload")
        assert done.code == 0, done
        assert '"cell2"' in container.get("/api/v1/robots", BEARER).text


def test_without_a_configuration_it_ends_with_78_and_says_what_to_mount(docker: Engine) -> None:
    done = docker.once()
    assert done.code == 78
    assert "/etc/robot-gateway/gateway.toml: does not exist" in done.err
    assert "mount it" in done.err


def test_an_open_listener_without_tokens_ends_with_78_and_says_how_to_make_one(docker: Engine, tmp_path: Path) -> None:
    done = docker.once(options=with_config(tmp_path, OPEN + ROBOT.format("r1")))
    assert done.code == 78
    assert "tokens" in done.err
    assert "insecure = true" in done.err
    assert "robot-gateway token" in done.err


def test_insecure_must_be_said_and_is_repeated_in_the_log(docker: Engine, tmp_path: Path) -> None:
    with docker.running(with_config(tmp_path, OPEN + "insecure = true\n" + ROBOT.format("r1"))) as container:
        assert within(20, container.healthy), container.logs()
        assert container.get("/metrics").status == 200
        assert "insecure" in container.logs()


def test_the_health_check_speaks_tls_where_the_doors_do(docker: Engine, tmp_path: Path) -> None:
    tls = '[server.tls]\ncertificate = "/etc/robot-gateway/certificate.pem"\nkey = "/etc/robot-gateway/key.pem"\n'
    options = with_config(tmp_path, OPEN + "insecure = true\n" + tls + ROBOT.format("r1"))
    folder = tmp_path / "gateway"
    make = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=cell"
    made = run(*make.split(), "-keyout", f"{folder}/key.pem", "-out", f"{folder}/certificate.pem")
    assert made.code == 0, made
    os.chown(folder / "key.pem", 10001, 10001)
    with docker.running(options) as container:
        assert within(20, container.healthy), container.logs()
        assert container.get("/healthz", url="https://127.0.0.1:8765").status == 200


def test_the_image_adds_no_compiler_no_pip_and_no_package_lists(docker: Engine) -> None:
    look = (
        "for name in gcc cc g++ c++ clang make ld as pip pip3; do command -v $name; done;"
        " ls /build /root/.cache /var/cache/pip 2>/dev/null;"
        " find /var/lib/apt/lists -type f; find /opt/robot-gateway -name pip -o -name '*.whl'; true"
    )
    done = docker.once("-c", look, options=["--user=0", "--entrypoint=sh"])
    assert (done.code, done.out) == (0, "")


def test_the_image_says_what_it_is(docker: Engine) -> None:
    (image,) = json.loads(docker.podman("image", "inspect", IMAGE).out)
    config = image["Config"]
    assert config["User"] == "10001:10001"
    assert config["StopSignal"] in {"SIGTERM", "15"}
    assert list(config["ExposedPorts"]) == ["8765/tcp"]
    assert (config["Entrypoint"], config["Cmd"]) == (["robot-gateway"], ["run"])
    assert "ROBOT_GATEWAY_CONFIG=/etc/robot-gateway/gateway.toml" in config["Env"]
    assert config["Labels"]["org.opencontainers.image.version"] == "0.0.0-test"
    assert config["Labels"]["org.opencontainers.image.licenses"] == "Apache-2.0"


def test_every_command_that_the_page_names_is_there(docker: Engine) -> None:
    told = docker.once("--help")
    assert told.code == 0
    for command in ("health", "reload", "token", "check"):
        assert f"  {command}" in told.out
