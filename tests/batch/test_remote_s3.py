"""The real command against a real S3 server on this machine."""

import json
import re
import subprocess

import pytest

from msal_cli.storage import objects as remote
from msal_cli.storage.objects import write_whole
from tests.batch import test_remote
from tests.batch.test_remote import outputs
from tests.batch.test_run import obj
from tests.cli.scans import MSAL, msal

pytestmark = pytest.mark.ci

WHY = "needs the extra: pip install '.[test]'"
s3fs = pytest.importorskip("s3fs", reason=WHY)
pytest.importorskip("moto.server", reason=WHY)

PAPER = ("--method", "msal")
NAMES = ("a/0.obj", "a/b/1.obj", "2.obj", "c d/%41#?ü+&=.obj")


class Server:
    """moto's server, with every request noted."""

    def __init__(self):
        from moto.server import ThreadedMotoServer

        self.requests = []
        self._moto = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
        self._moto.start()
        self.url = "http://{}:{}".format(*self._moto.get_host_and_port())
        server = self._moto._server
        self._app, server.app = server.app, self._answer

    def _answer(self, environ, start_response):
        self.requests.append(f"{environ['REQUEST_METHOD']} {environ['PATH_INFO']}")
        return self._app(environ, start_response)

    def counted(self, pattern):
        """How many requests match a method and path."""
        return sum(re.fullmatch(pattern, request) is not None for request in self.requests)

    def stop(self):
        self._moto.stop()


@pytest.fixture(scope="module")
def server():
    one = Server()
    given = {
        "AWS_ENDPOINT_URL": one.url,
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "geheim",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in given.items():
            patch.setenv(name, value)
        remote._file_systems.clear()
        s3fs.S3FileSystem.clear_instance_cache()
        system = s3fs.S3FileSystem()
        system.mkdir("scans")
        system.mkdir("out")
        for n, name in enumerate(NAMES):
            write_whole(f"s3://scans/{name}", obj(n).encode())
        yield one
        remote._file_systems.clear()
        s3fs.S3FileSystem.clear_instance_cache()
    one.stop()


@pytest.fixture(scope="module")
def expected():
    return test_remote.expected(NAMES)


def run(*arguments):
    return subprocess.run([*MSAL, *arguments], capture_output=True, text=True, timeout=120)


def statuses(path):
    records = json.loads(path.read_text())["records"]
    return {record["input"].partition("scans/")[2]: record["status"] for record in records}


def test_from_bucket_to_bucket(server, expected, tmp_path):
    command = ["denoise", "s3://scans", "-o", "s3://out/x", "-j", "1", "-q", *PAPER]
    report = tmp_path / "report.json"
    server.requests = []
    done = run(*command, "--report", str(report))
    assert (done.returncode, done.stderr) == (0, "")
    assert statuses(report) == dict.fromkeys(NAMES, "written")
    assert "geheim" not in report.read_text()
    n = len(NAMES)
    assert server.counted("GET /scans/.*") == n
    assert server.counted(r"(PUT|HEAD) /out/x/[^.].*") == 2 * n
    # Listings, and the parts of the manifest.
    assert len(server.requests) - 3 * n < 15
    assert outputs("s3://out/x") == expected

    # What the run did can be reported later, from the store alone.
    listed = msal("report", "s3://out/x", "--json", "--check")
    assert listed.exit_code == 0
    assert json.loads(listed.stdout)["totals"]["written"] == n

    # Nothing is downloaded, and of all objects together there are two listings.
    server.requests = []
    assert msal(*command, "--report", report).exit_code == 0
    assert statuses(report) == dict.fromkeys(NAMES, "up-to-date")
    assert server.counted(".* /(scans|out)") == 2 + 2
    assert not server.counted(r".* /(scans/.*|out/x/[^.].*)")
    # Beside the parts of the manifest, of which a slow run has more.
    assert len(server.requests) - server.counted(r".*/\.msal-manifest/.*") < 12


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["s3://missing/scans", "-o", "s3://out/y"], 2, "no object or folder"),
        (["s3://scans/2.obj", "-o", "s3://missing/y.obj"], 1, "no such bucket"),
    ],
)
def test_what_cannot_be_is_told_in_words(server, arguments, status, words):
    made = msal("denoise", *arguments)
    assert made.exit_code == status
    assert words in made.stderr and "hint:" in made.stderr
    assert "Traceback" not in made.stderr and "geheim" not in made.stderr
