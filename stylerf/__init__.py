"""Stylized radiance fields: the algorithms, without file access, argument parsing or printing.

Public API (examples/render_field.py uses it; everything else may change without notice):

    geometry.cameras.Camera             a pinhole camera and its rays
    geometry.space_warp.SpaceWarp       the warp of world space to the unit cube
    fields.radiance_field.RadianceField a density and a color part in that space
    fields.protocol                     interface of density and color parts; vm, hash and voxel parts are in fields/
    rendering.view.render_view          a whole view: rgb, alpha, distances, masks
    rendering.rays                      render_rays() and backward()
    training.fit.fitter.Fitter          fits a field to photos
    training.stylize                    stylizes a field
    metrics                             image, depth and consistency metrics

Images are float32 arrays [h, w, c], sRGB-encoded, 0..1. Camera axes are OpenCV's: x right, y down, z forward. Functions
raise the exceptions of stylerf.errors. The pipeline, which reads and writes folders, is in `stages`.
"""

__version__ = "0.1.0"
