"""The built-in metrics: registration only, each is imported when it is used."""

from clothbench import Registration, hookimpl


@hookimpl
def clothbench_metrics():
    return [
        Registration("profile", "clothbench_metrics.profile:Profile", "squared distances to the surface, in m²"),
        Registration("node_error", "clothbench_metrics.node_error:NodeError", "mean distance of the nodes, in mm"),
        Registration(
            "relative_error",
            "clothbench_metrics.relative_error:RelativeError",
            "distance over the size of the shape, in percent",
        ),
        Registration(
            "relative_error_from_camera",
            "clothbench_metrics.relative_error:RelativeErrorFromCamera",
            "distance over how far the camera is away, in percent",
        ),
        Registration(
            "relative_error_squares",
            "clothbench_metrics.relative_error:RelativeErrorSquares",
            "squared distances of the nodes, in m²",
        ),
        Registration(
            "fold", "clothbench_metrics.fold:Fold", "orientation of projected stripes along folds, and the silhouette"
        ),
        Registration(
            "drape",
            "clothbench_metrics.drape:Drape",
            "drape coefficient and folds, in standard deviations between captures; several objectives",
        ),
        Registration("silhouette", "clothbench_metrics.silhouette:Silhouette", "mismatched pixels of the outline"),
        Registration(
            "marked_edges",
            "clothbench_metrics.marked_edges:MarkedEdges",
            "distance in the picture of lines marked on the cloth, in px",
        ),
        Registration(
            "fold_count", "clothbench_metrics.fold_count:FoldCount", "mean number of folds in the picture, statistical"
        ),
        Registration(
            "chamfer",
            "clothbench_metrics.clouds:Chamfer",
            "mean distance between clouds whose points have no identity, both ways, in mm",
        ),
        Registration(
            "hausdorff",
            "clothbench_metrics.clouds:Hausdorff",
            "largest distance between clouds whose points have no identity, in mm",
        ),
        Registration(
            "spectrum", "clothbench_metrics.spectrum:Spectrum", "frequency and decay of the swing, in percent"
        ),
    ]
