"""Shell completion: the scripts, and what they are answered."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from tests.cli.scans import msal, process


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script(shell):
    made = msal("completion", shell)
    assert made.exit_code == 0
    assert f"_MSAL_COMPLETE={shell}_complete" in made.stdout
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=made.stdout, text=True, check=True)


def test_no_such_shell():
    made = msal("completion", "cmd")
    assert (made.exit_code, made.stdout) == (2, "")


@pytest.mark.parametrize(
    ("words", "answers"),
    [
        (["msal", ""], {"plain,denoise", "plain,info", "plain,methods", "plain,completion"}),
        (["msal", "de"], {"plain,denoise"}),
        (["msal", "methods", "ms"], {"plain,msal"}),
        (["msal", "denoise", "--method", ""], {"plain,al", "plain,msal"}),
        (["msal", "denoise", "--enc"], {"plain,--encoding"}),
        (["msal", "denoise", "--encoding", "a"], {"plain,ascii"}),
        (["msal", "denoise", "-o", "x"], {"file,x"}),
        (["msal", "denoise", "sc"], {"file,sc"}),
    ],
)
def test_what_bash_is_answered(words, answers, monkeypatch):
    monkeypatch.setenv("_MSAL_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", " ".join(words))
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    assert answers <= set(msal().stdout.splitlines())


def test_a_real_completion_is_answered_without_noise():
    made = process(
        env={
            "_MSAL_COMPLETE": "bash_complete",
            "COMP_WORDS": "msal methods ",
            "COMP_CWORD": "2",
        }
    )
    assert (made.returncode, made.stderr) == (0, b"")
    assert b"plain,msal" in made.stdout
