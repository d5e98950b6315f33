"""The built-in trackers: registration only, each is imported when it is used."""

from clothbench import Registration, hookimpl


@hookimpl
def clothbench_trackers():
    return [
        Registration(
            "cloud",
            "clothbench_trackers.cloud:Cloud",
            "point clouds as they are, of which nobody knows which point is which",
        ),
        Registration(
            "cloud_template",
            "clothbench_trackers.cloud_template:CloudTemplate",
            "frames of a depth camera → a template of the sheet, bent frame by frame onto the cloud",
        ),
        Registration(
            "depth_mesh",
            "clothbench_trackers.depth_mesh:DepthMesh",
            "frames of a depth camera → a quadrilateral mesh of the sheet, by arclength along warp and weft",
        ),
        Registration(
            "drape",
            "clothbench_trackers.drape:Drape",
            "shadows of a drapemeter → outlines: drape coefficient, number, depth and evenness of folds",
        ),
        Registration(
            "laser_profile",
            "clothbench_trackers.laser_profile:LaserProfile",
            "laser line in the images of a calibrated camera → points of the cloth in the laser's plane",
        ),
        Registration(
            "markers",
            "clothbench_trackers.markers:Markers",
            "node recordings and marker files (C3D, TRC, CSV), with gaps kept and a rigid frame alignment",
        ),
        Registration(
            "optical_flow",
            "clothbench_trackers.optical_flow:OpticalFlow",
            "colour video of a printed cloth → its graph, by Lucas-Kanade flow from frame to frame",
        ),
        Registration(
            "sift_graph",
            "clothbench_trackers.sift_graph:SiftGraph",
            "colour video of a printed cloth → its graph, by SIFT keypoints of each cell of a template",
        ),
        Registration(
            "stripes",
            "clothbench_trackers.stripes:Stripes",
            "projected stripes in a calibrated video: silhouette, angle map, folds",
        ),
    ]
