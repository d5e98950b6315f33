#!/usr/bin/env bash
# Runs a suite at a base commit and at the checked-out one, each in an environment of its own, and compares them.
#
#   BASE=main WORDS="+suite=static_dynamic model=mass_spring" tools/compare_commits.sh
#
# WORDS: what `clothbench run` is told, words apart by blanks or lines; INSTALL: what pip installs of either commit
# (default "."); CLOTHBENCH: a checkout of clothbench that is installed first, where the repository is not clothbench
# itself; BASE: the commit before where it is empty or zeros; RESULTS: folder for environments, results and comment.md,
# of which those of an earlier use are removed;
# HISTORY: folder of `clothbench history` that gets an entry for the checked-out commit, and a page (index.html).
# Exits with 1 if something got worse, which stands in comment.md; but with 0 in a job of GitHub Actions, where it stands
# in the summary and in the output `passed` for a later step. Exits with another code if one of the two could not be run
# or compared: with that of clothbench, or with 3.
set -eEuo pipefail
trap 'exit 3' ERR # git, venv and pip say 1 as well

results=$(realpath -m "${RESULTS:-$(mktemp -d)}")
mkdir -p "$results"
rm -rf "$results"/{base/runs,head/runs,env-base,env-head,comment.md} # of an earlier use of the same folder

base=${BASE:-}
if [[ $base =~ ^0*$ ]]; then base=HEAD^; fi # a first push of a branch says zeros, a schedule nothing
if ! git rev-parse --quiet --verify "$base^{commit}" > /dev/null; then
    echo "compare_commits.sh: BASE: found no commit $base in this checkout, expected one; fetch all of them (fetch-depth: 0)" >&2
    exit 2
fi
# Of all lines, not of the first only; there is no end mark, so that read says 1.
read -r -d '' -a words <<< "${WORDS:-+suite=static_dynamic}" || true
read -r -d '' -a install <<< "${INSTALL:-.}" || true
git worktree add --quiet --force --detach "$results/base-tree" "$base"
trap 'git worktree remove --force "$results/base-tree"' EXIT

# Of the environment, what the code under test may see: nothing of a job's tokens, nor of the files by which a step
# speaks to the next ones.
seen=()
for name in $(compgen -e); do
    case "$name" in
        PATH | HOME | LANG | LC_* | TZ | TMPDIR | LD_LIBRARY_PATH | PIP_* | SSL_CERT_* | REQUESTS_CA_BUNDLE | \
            http_proxy | https_proxy | no_proxy | HTTP_PROXY | HTTPS_PROXY | NO_PROXY | OPENBLAS_* | CLOTHBENCH_DATA)
            seen+=("$name=${!name}") ;;
    esac
done
alone() { env -i "${seen[@]}" "$@"; }
only_1() { if [[ $1 != 1 ]]; then exit "$1"; fi; } # clothbench has done what it was told, and found something

run() { # NAME FOLDER: results of the commit that is checked out in FOLDER, in $results/NAME
    alone python3 -m venv "$results/env-$1"
    if [[ -n ${CLOTHBENCH:-} ]]; then
        alone "$results/env-$1/bin/pip" install --quiet --disable-pip-version-check "$CLOTHBENCH"
    fi
    (cd "$2" && alone "$results/env-$1/bin/pip" install --quiet --disable-pip-version-check "${install[@]}")
    # From an empty folder, so that what is installed is what runs. Cells that fail are rows of the comparison.
    mkdir -p "$results/$1"
    (cd "$results/$1" &&
        alone "$results/env-$1/bin/clothbench" run "${words[@]}" rerun=false out="$results/$1/runs") || only_1 $?
}
run base "$results/base-tree"
run head .

passed=true
alone "$results/env-head/bin/clothbench" compare --markdown "$results/base/runs" "$results/head/runs" \
    > "$results/comment.md" || { only_1 $?; passed=false; }
cat "$results/comment.md"
if [[ -n ${GITHUB_OUTPUT:-} ]]; then
    echo "passed=$passed" >> "$GITHUB_OUTPUT"
    cat "$results/comment.md" >> "$GITHUB_STEP_SUMMARY"
fi
if [[ -n ${HISTORY:-} ]]; then
    alone "$results/env-head/bin/pip" install --quiet --disable-pip-version-check 'clothbench[history]'
    alone "$results/env-head/bin/clothbench" history "$HISTORY" --add "$results/head/runs" --page "$HISTORY/index.html"
fi
echo "results: $results" >&2
if [[ -z ${GITHUB_OUTPUT:-} && $passed = false ]]; then exit 1; fi
