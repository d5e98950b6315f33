"""Importer for `iri_wam_cloth_swing`: a 30 × 30 cm cloth on a hanger, swung by a robot arm, meshed by a
depth camera.

What is done to the data, in this order: nodes ordered and the sheet unrolled (lattice, iri_sheets); camera, hanger
and clocks brought together per session and lattice size (iri_alignment); frames at odds with the tool
dropped, the start cut to a rest, nodes labelled by their way from the hanger, and one recording written per mesh
file (iri_recording).
`import-report.json` says what became of each.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from clothbench.core.errors import ClothbenchError
from clothbench.core.progress import FileProgress
from clothbench.datasets import registry
from clothbench.datasets.iri_alignment import fit_rig
from clothbench.datasets.iri_files import Source, find_sources
from clothbench.datasets.iri_recording import Origin, build, take_of, with_paths
from clothbench.datasets.iri_rest import noise_at_rest
from clothbench.datasets.iri_rig import Take
from clothbench.datasets.iri_sheets import Sheet, read_sheet
from clothbench.datasets.report import ImportReport, write_report
from clothbench.recordings.codec import write
from clothbench.recordings.nodes import LAYOUT

NAME = "iri_wam_cloth_swing"
REPORT = "import-report.json"
NEXT = "clothbench run +suite=iri_swing recordings={folder}"
LAST_FIT_REPEAT = 5  # of the ten recordings of a range
NO_TOOL = (
    "tool pose not measured; the commanded path strays up to 25 mm from the measured one where both exist, "
    "and the speed it was played at is not recorded"
)


@dataclass
class _Job:
    """One call of `convert`: where from, where to, and what is known beforehand."""

    root: Path
    out: Path
    splits: dict[Path, str]
    check: registry.Check
    planned: int
    progress: FileProgress | None
    reports: list[ImportReport] = field(default_factory=list)

    def done(self, report: ImportReport) -> None:
        self.reports.append(report)
        if self.progress:
            self.progress(len(self.reports), self.planned, report.source)

    def name(self, path: Path) -> str:
        return path.relative_to(self.root).as_posix()


def convert(source: Path, out: Path, progress: FileProgress | None = None) -> list[ImportReport]:
    """Write one recording per usable mesh file under `source` into `out`, with import-report.json, in which outputs are
    relative to `out`; returns all reports.

    `progress(done, planned, name)` is called after every file. A file that cannot be used is reported with
    the reason and does not stop the others; a folder without such files is an error.
    """
    source, out = Path(source), Path(out)
    sources = find_sources(source)
    check = registry.verify(NAME, source)
    job = _Job(source, out, split_by_repeat(sources), check, len(sources), progress)
    groups: dict[tuple[str, int], list[Source]] = defaultdict(list)
    for one in sources:
        groups[one.session, one.n].append(one)
    for members in groups.values():
        _convert_group(members, job)
    reports = sorted(job.reports, key=lambda report: report.source)
    dataset = registry.DATASETS[NAME]
    header = {"dataset": NAME, "source": f"{dataset.repository}@{dataset.commit}", "licence": dataset.licence}
    told = [with_paths(r, r.source, r.output and Path(r.output).relative_to(out).as_posix()) for r in reports]
    write_report(told, out / REPORT, **header, next=NEXT)
    return reports


def split_by_repeat(sources: Sequence[Source]) -> dict[Path, str]:
    """Mesh file → "fit" or "held_out", by the number that files call the repeat.

    Of each range there are up to ten recordings, each another random motion of that range: 1 to 5 are for
    fitting, 6 and up held out, whichever are at hand. The traj motions were repeated up to three times: the
    last one is held out (of traj9 it was played 2.4 times as fast), a motion done once is fitted.
    """
    repeats: dict[tuple[str, int, str], set[int]] = defaultdict(set)
    for one in sources:
        repeats[one.session, one.n, one.motion].add(one.repeat)
    split = {}
    for one in sources:
        all_of_it = repeats[one.session, one.n, one.motion]
        last = max(all_of_it) if len(all_of_it) > 1 else one.repeat + 1
        held = one.repeat > LAST_FIT_REPEAT if one.motion.startswith("range") else one.repeat == last
        split[one.path] = "held_out" if held else "fit"
    return split


def _refuse(source: Source, job: _Job) -> None:
    """Raise with the reason if a mesh file cannot be a recording, before anything in it is read."""
    reason = None
    if "calibration" in source.stem:
        reason = "calibration, no motion"
    elif "blooper" in source.stem:
        reason = "marked as a blooper by those who recorded it"
    elif not source.motion:
        reason = "its name tells no motion and repeat, expected range<K>_rep<R> or n<N>_traj<K>_<R>"
    elif not source.tool.is_file():
        reason = NO_TOOL
    elif wrong := sorted(set(map(job.name, _files(source))) & job.check.wrong):
        reason = f"{wrong[0]}: SHA-256 differs from the registry's; fetch it again"
    if reason:
        raise ClothbenchError(reason)


def _files(source: Source) -> tuple[Path, Path, Path]:
    return source.path, source.tool, source.camera


def _convert_group(members: Sequence[Source], job: _Job) -> None:
    """All recordings of one session and lattice size: they share camera, hanger and clocks."""
    ready: list[tuple[Sheet, Take]] = []
    for source in members:
        try:
            _refuse(source, job)
            sheet = read_sheet(source)
            ready.append((sheet, take_of(sheet)))
        except ClothbenchError as fault:
            job.done(ImportReport(job.name(source.path), skipped=str(fault)))
    if not ready:
        return
    # Only what is for fitting may shape the shared rig, so that held-out recordings stay unseen by it.
    fitting = [pair for pair in ready if job.splits[pair[0].source.path] == "fit"] or ready
    try:
        rig = fit_rig([take for _, take in fitting])
    except ClothbenchError as fault:
        for sheet, _ in ready:
            job.done(ImportReport(job.name(sheet.source.path), frames_in=sheet.frames_in, skipped=str(fault)))
        return
    noise = noise_at_rest(rig, fitting)
    for sheet, take in ready:
        name, origin = job.name(sheet.source.path), _origin(sheet.source, job)
        try:
            recording, report = build(sheet, take, rig, noise, origin)
            path = write(recording, job.out / f"{sheet.source.name}.nc", LAYOUT)
            job.done(with_paths(report, name, str(path)))
        except ClothbenchError as fault:
            job.done(ImportReport(name, frames_in=sheet.frames_in, notes=origin.remarks, skipped=str(fault)))


def _origin(source: Source, job: _Job) -> Origin:
    """Where a recording comes from, and which of its files the registry could not vouch for."""
    dataset, name = registry.DATASETS[NAME], job.name(source.path)
    upstream, _ = dataset.files.get(name, (name, ""))
    unknown = sorted(set(map(job.name, _files(source))) & job.check.unknown)
    remarks = tuple(f"{one} is not in the registry: not verified" for one in unknown)
    stated = f"github.com/{dataset.repository}@{dataset.commit}: {upstream}"
    return Origin(stated, dataset.licence, job.splits[source.path], remarks)
