"""The kinds of study, a room each: its cells, how one is run, its tables, and its sections of the page."""

from clothbench.plugins.hookspecs import Registration, hookimpl


@hookimpl
def clothbench_studies():
    return [
        Registration(
            "calibration", "clothbench.studies.calibration.study", "parameters fitted to recordings, judged on others"
        ),
        Registration(
            "mechanics", "clothbench.studies.mechanics.study", "models in scenes whose answer mechanics knows"
        ),
        Registration(
            "folding", "clothbench.studies.folding.study", "a strip lifted step by step, its stiffness estimated"
        ),
        Registration(
            "fold_path",
            "clothbench.studies.fold_path.study",
            "a strip or a sheet folded in half along a gripper's path",
        ),
        Registration(
            "improve", "clothbench.studies.improve.study", "what a calibrated model lacks, found, added and judged"
        ),
        Registration("speed", "clothbench.studies.speed.study", "how fast models step beside the installed peers"),
    ]
