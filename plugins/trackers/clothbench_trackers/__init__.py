"""The built-in trackers: registration only, each is imported when it is used."""

from clothbench.hookspecs import Registration, hookimpl


@hookimpl
def clothbench_trackers():
    return [
        Registration(
            "markers",
            "clothbench_trackers.markers:Markers",
            "node recordings and marker files (C3D, TRC, CSV), with gaps kept and a rigid frame alignment",
        ),
        Registration(
            "stripes",
            "clothbench_trackers.stripes:Stripes",
            "projected stripes in a calibrated video: silhouette, angle map, folds",
        ),
    ]
