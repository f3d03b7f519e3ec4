"""However the files are handed out, the outputs are the same to the last bit.

python -m pytest tests/campaigns/test_same_bytes.py -m slow -s
"""

from __future__ import annotations

import importlib.util
import sys

import pytest

from tests.campaigns.runs import STATUS, command, contents, ended, scans_in

pytestmark = pytest.mark.slow


def test_one_job_several_shards_and_dask_write_the_same(tmp_path):
    scans = scans_in(tmp_path / "in")
    ways = {
        "-j 1": [["-j", "1"]],
        "-j 2": [["-j", "2"]],
        "-j 5": [["-j", "5"]],
        "four shards": [["-j", "1", "--shard", f"{k}/4"] for k in (3, 1, 4, 2)],
    }
    if importlib.util.find_spec("distributed") and sys.platform != "win32":
        ways["Dask"] = [["-j", "2", "--engine", "dask", "--scheduler", "local"]]
    written = {}
    for number, (name, runs) in enumerate(ways.items()):
        output = tmp_path / f"out{number}"
        statuses = [ended(command(scans, output, *options))[0] for options in runs]
        # The damaged file is in one shard, alone or among others.
        assert set(statuses) <= {0, 1, STATUS} and any(statuses), (name, statuses)
        written[name] = contents(output)
    names = {name: sorted(files) for name, files in written.items()}
    print(f"\n{len(written['-j 1'])} files alike by {', '.join(written)}")
    for name, files in written.items():
        files = {one: data for one, data in files.items() if not one.startswith(".msal-")}
        assert files == written["-j 1"], (name, names[name])
