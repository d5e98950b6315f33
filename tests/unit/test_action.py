"""`action.yml`: its steps are run in bash as a runner would, with python, pip and gh replaced by stand-ins that note
what they are told. What GitHub itself does (checkout, rights of tokens) is not here.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml
from conftest import ROOT
from test_gate import row

from clothbench.engine.leaderboard import ROW, SYSTEM
from clothbench.engine.store import Store

TOKEN = "sekret-token"
ACTION = yaml.safe_load((ROOT / "action.yml").read_text())
pytestmark = pytest.mark.skipif(not (shutil.which("bash") and shutil.which("git")), reason="needs bash and git")

# python3 -m venv FOLDER makes an environment whose pip and clothbench note their surroundings. `run` copies the
# results that are ready for that side, or ends with the code that exits=CODE says; all else is clothbench itself. pip
# finds no package `absent`.
PYTHON = """#!/usr/bin/env bash
mkdir -p "$3/bin"
cat > "$3/bin/pip" <<'PIP'
#!/usr/bin/env bash
{ echo "pip $*"; env; } >> STRANGER
[[ $* != *absent* ]]
PIP
cat > "$3/bin/clothbench" <<'CLOTHBENCH'
#!/usr/bin/env bash
{ echo "clothbench $*"; env; } >> STRANGER
if [[ $1 = run ]]; then
    side=$(basename "$PWD")
    for word in "$@"; do
        case "$word" in out=*) folder=${word#out=} ;; exits=*) exit "${word#exits=}" ;; esac
    done
    exec cp -r "BOARDS/$side" "$folder"
fi
exec REAL -m clothbench "$@"
CLOTHBENCH
chmod +x "$3/bin/pip" "$3/bin/clothbench"
"""
GH = """#!/usr/bin/env bash
echo "token=${GH_TOKEN:-none} $*" >> NOTES
case "$*" in
    *--method*) for word in "$@"; do case "$word" in body=@*) cp "${word#body=@}" COMMENT ;; esac; done ;;
    *) if [[ -s COMMENT ]] && head -n 1 COMMENT | grep -qF "$MARK"; then echo 77; fi ;;
esac
"""


@dataclass
class Job:
    """A job on a runner: a repository with two commits, and what came of the action's steps."""

    place: Path
    event: dict[str, Any]
    inputs: dict[str, str]
    steps: list[tuple[str, int, str]] = field(default_factory=list)  # name, exit code, what it said
    outputs: dict[str, str] = field(default_factory=dict)

    def expression(self, text: str) -> Any:
        """What GitHub would make of an expression, as far as the action uses them."""
        known = {
            "github.event_name": self.event["name"], "github.repository": "me/plate", "github.token": TOKEN,
            "github.action_path": str(ROOT), "github.server_url": str(self.place / "server"),
            "runner.temp": str(self.place / "temp"), "github.event.before": self.event.get("before", ""),
            "github.event.pull_request.base.sha": self.event.get("base", ""),
            "github.event.pull_request.head.repo.full_name": self.event.get("from", ""),
            "github.event.pull_request.number": "7",
            **{f"inputs.{name}": value for name, value in self.inputs.items()},
            **{f"steps.compare.outputs.{name}": value for name, value in self.outputs.items()},
        }  # fmt: skip
        found = re.sub(r"\b(?:github|runner|inputs|steps)(?:\.\w+)+", lambda m: repr(known.get(m[0], "")), text)
        found = found.replace("&&", " and ").replace("||", " or ").replace("always()", "True")
        return eval(found, {"format": lambda form, *words: form.format(*words)})

    def filled(self, text: str) -> str:
        return re.sub(r"\$\{\{(.*?)\}\}", lambda m: str(self.expression(m[1].strip())), str(text))

    def run(self) -> bool:
        """Every step as the runner takes them; whether the job is green."""
        for name, about in ACTION["inputs"].items():
            self.inputs.setdefault(name, self.filled(about["default"]))
        good = True
        for step in ACTION["runs"]["steps"]:
            condition = step.get("if", "")
            if (good or "always()" in condition) and (not condition or self.expression(condition)):
                good = self.step(step) and good
        return good

    def step(self, step: dict[str, Any]) -> bool:
        told = {name: self.filled(value) for name, value in step.get("env", {}).items()}
        files = {name: str(self.place / name) for name in ("GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY", "GITHUB_ENV")}
        kept = {name: os.environ[name] for name in ("HOME", "LANG") if name in os.environ}
        environment = {
            **kept, **files, **told, "PATH": f"{self.place / 'bin'}:{os.environ['PATH']}", "GITHUB_SHA": "b" * 40,
            "GITHUB_REPOSITORY": "me/plate", "ACTIONS_RUNTIME_TOKEN": TOKEN, "GIT_TERMINAL_PROMPT": "0",
        }  # fmt: skip
        words = ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c", step["run"]]
        done = subprocess.run(
            words, cwd=self.place / "repository", env=environment, capture_output=True, text=True, check=False
        )
        self.steps.append((step["name"], done.returncode, done.stdout + done.stderr))
        if step.get("id") == "compare" and (self.place / "GITHUB_OUTPUT").is_file():
            lines = (self.place / "GITHUB_OUTPUT").read_text().splitlines()
            self.outputs = dict(line.split("=", 1) for line in lines)
        return done.returncode == 0

    @property
    def done(self) -> list[str]:
        return [name for name, _, _ in self.steps]

    def read(self, name: str) -> str:
        path = self.place / name
        return path.read_text() if path.is_file() else ""


def git(folder: Path, *words: str) -> str:
    about = ["-c", "user.name=n", "-c", "user.email=n@example.org", "-c", "commit.gpgsign=false"]
    done = subprocess.run(["git", "-C", folder, *about, *words], check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def job(tmp_path):
    """A job of an event; values: of the one row at base and at head."""
    (tmp_path / "repository").mkdir()
    (tmp_path / "temp").mkdir()
    repository = tmp_path / "repository"
    git(repository, "init", "--quiet")
    for subject in ("base", "head"):
        git(repository, "commit", "--quiet", "--allow-empty", "-m", subject)
    git(tmp_path, "init", "--quiet", "--bare", "server/me/plate")
    (tmp_path / "bin").mkdir()
    places = {
        "STRANGER": "stranger.log",
        "BOARDS": "boards",
        "FILL": "fill.py",
        "NOTES": "gh.log",
        "COMMENT": "comment",
    }
    for name, script in (("python3", PYTHON), ("gh", GH)):
        for word, place in places.items():
            script = script.replace(word, str(tmp_path / place))
        (tmp_path / "bin" / name).write_text(script.replace("REAL", sys.executable))
        (tmp_path / "bin" / name).chmod(0o755)

    def made(name: str, values: tuple[float, float] = (10.0, 10.0), *, of: str = "me/plate", **inputs: str) -> Job:
        for side, value in zip(("base", "head"), values, strict=True):
            kept = row(value, key="ab", seed=None, recording=None, evaluations=5, wall_s=1.0, cpu="a cpu", cores=2)
            shutil.rmtree(tmp_path / "boards" / side, ignore_errors=True)
            Store(tmp_path / "boards" / side).put("ab", {"rows": [{**dict.fromkeys({**ROW, **SYSTEM}), **kept}]})
        before = git(repository, "rev-parse", "HEAD~1")
        event = {"pull_request": {"base": before, "from": of}, "push": {"before": before}}.get(name, {})
        shutil.rmtree(tmp_path / "temp", ignore_errors=True)
        return Job(tmp_path, {"name": name, **event}, {"run": "+suite=mine", **inputs})

    return made


WORSE = "**gate failed: 1 rows compared, 1 worse, 0 missing, 0 better, 0 only in NEW**"


def test_a_pull_request_gets_one_comment_and_fails_beyond_the_noise_and_no_token_is_near_the_code_under_test(job):
    found = job("pull_request", (10.0, 20.0))
    assert not found.run()
    assert found.steps[-1][:2] == ("Verdict", 1)
    assert found.outputs == {"passed": "false"}
    lines = found.read("comment").splitlines()
    assert lines[:2] == ["<!-- clothbench +suite=mine -->", WORSE]
    assert lines[5].startswith("| `worse` | `x · x · x · x · x · x · x` | `10 mm` | `20 mm` |")
    assert found.read("GITHUB_STEP_SUMMARY").splitlines()[0] == WORSE
    told = found.read("stranger.log")
    assert told.count("clothbench run +suite=mine rerun=false") == 2
    assert "GITHUB_" not in told
    assert TOKEN not in told
    assert TOKEN in found.read("gh.log")  # and where it is needed it is
    again = job("pull_request", (10.0, 10.1))
    assert again.run()
    assert "--method POST" in found.read("gh.log").splitlines()[1]
    assert "--method PATCH repos/me/plate/issues/comments/77" in found.read("gh.log").splitlines()[3]
    assert "gate passed" in again.read("comment")


def test_a_second_use_in_one_job_compares_its_own_results(job):
    """A runner keeps its temporary folder from step to step."""
    first = job("pull_request", (10.0, 20.0))
    first.run()
    kept = (first.place / "temp").rename(first.place / "kept")
    second = job("pull_request", (10.0, 10.1), run="+suite=other")
    kept.rename(first.place / "temp")
    assert second.run(), second.steps
    lines = second.read("comment").splitlines()
    assert lines[0] == "<!-- clothbench +suite=other -->"
    assert "gate passed" in lines[1]


def test_every_line_of_what_is_run_and_installed_counts(job):
    found = job("pull_request", run="+suite=mine\nmodel=one,two\n  budget=5\n", install="numpy\n.\n")
    assert found.run(), found.steps
    told = found.read("stranger.log")
    assert told.count("clothbench run +suite=mine model=one,two budget=5 rerun=false") == 2
    assert told.count("--disable-pip-version-check numpy .\n") == 2


def test_a_fork_has_the_table_in_its_summary_and_no_step_with_a_token(job):
    found = job("pull_request", (10.0, 20.0), of="stranger/plate", history="kept")
    assert not found.run()
    assert found.done == ["No code of others beside a token", "Run base and head, and compare", "Verdict"]
    assert found.read("GITHUB_STEP_SUMMARY").splitlines()[0] == WORSE
    assert found.read("gh.log") == ""


@pytest.mark.parametrize("event", ["pull_request_target", "workflow_run", "issue_comment"])
def test_events_with_a_token_beside_code_of_forks_are_refused(job, event):
    found = job(event)
    assert not found.run()
    assert len(found.steps) == 1
    assert f"found event {event}" in found.steps[0][2]


@pytest.mark.parametrize(
    "event", [{"name": "schedule"}, {"name": "workflow_dispatch"}, {"name": "push", "before": "0" * 40}]
)
def test_where_the_event_names_no_base_it_is_the_commit_before(job, event):
    found = job("schedule", (10.0, 20.0))
    found.event = event
    assert not found.run()
    assert found.outputs == {"passed": "false"}
    assert found.read("GITHUB_STEP_SUMMARY").splitlines()[0] == WORSE


def test_a_base_that_is_not_fetched_is_one_line(job):
    found = job("pull_request", base="a" * 40)
    assert not found.run()
    name, code, said = found.steps[1]
    assert (name, code) == ("Run base and head, and compare", 2)
    assert said.strip().splitlines()[-1].startswith(f"compare_commits.sh: BASE: found no commit {'a' * 40}")


@pytest.mark.parametrize(
    ("value", "inputs", "code"),
    [
        (10.0, {}, 0),
        (20.0, {}, 1),
        (10.0, {"install": "absent"}, 3),
        (10.0, {"run": "+suite=mine exits=2"}, 2),
        (10.0, {"run": "+suite=mine exits=137"}, 137),
        (10.0, {"run": "+suite=mine exits=1"}, 2),
    ],
    ids=["same", "worse", "not installed", "wrong use", "killed", "no results to compare"],
)
def test_outside_of_actions_the_script_itself_says_whether_something_got_worse(job, value, inputs, code):
    found = job("push", (10.0, value), **inputs)
    for name, about in ACTION["inputs"].items():
        found.inputs.setdefault(name, found.filled(about["default"]))
    script = next(step for step in ACTION["runs"]["steps"] if step.get("id") == "compare")
    found.step({**script, "run": f"unset GITHUB_OUTPUT\n{script['run']}"})
    assert (found.steps[-1][1], found.outputs) == (code, {}), found.steps[-1][2]


def test_a_token_left_by_the_checkout_is_refused(job):
    found = job("pull_request")
    git(found.place / "repository", "config", "http.https://github.com/.extraheader", "AUTHORIZATION: basic x")
    assert not found.run()
    assert "persist-credentials: false" in found.steps[0][2]
    assert found.read("stranger.log") == ""


def test_every_push_adds_an_entry_to_the_history_on_its_branch(job):
    pytest.importorskip("ruptures", reason="ruptures is not installed: pip install 'clothbench[history]'")
    for number, value in enumerate((10.0, 11.0)):
        found = job("push", (10.0, value), history="kept")
        git(found.place / "repository", "commit", "--quiet", "--allow-empty", "-m", f"push {number}")
        found.run()
        assert found.steps[-2][:2] == ("Keep the history", 0), found.steps[-2][2]
    server = found.place / "server" / "me" / "plate"
    names = git(server, "ls-tree", "--name-only", "kept").splitlines()
    assert names[-1] == "index.html"
    entries = [json.loads(git(server, "show", f"kept:{name}")) for name in names[:-1]]
    assert [e["subject"] for e in entries] == ["push 0", "push 1"]
    assert "push 1" in git(server, "show", "kept:index.html")
    assert TOKEN not in found.read("stranger.log")
