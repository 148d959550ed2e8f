"""PSNR, SSIM and LPIPS of images, and the Chamfer distance of DTU.

Each metric has a fixed and named definition.

The definitions, and comparisons with other programs, are in docs/metrics.md. Store the result of `identity`
beside every measured value.
"""

from msb.metrics.chamfer import chamfer_dtu, chamfer_points, chamfer_surface
from msb.metrics.culling import CulledMesh, cull_dtu
from msb.metrics.dtu_data import DtuScan, read_dtu_scan
from msb.metrics.identity import Identity, ImageMetric
from msb.metrics.image_files import IMAGE_SUFFIXES, read_image
from msb.metrics.images import psnr, ssim
from msb.metrics.pairs import ImagePair, pair_images
from msb.metrics.perceptual import LpipsVgg, MetricWarning, lpips_vgg
from msb.metrics.registry import IMAGE_METRICS, METRICS, Measures, identity

__all__ = [
    "IMAGE_METRICS",
    "IMAGE_SUFFIXES",
    "METRICS",
    "CulledMesh",
    "DtuScan",
    "Identity",
    "ImageMetric",
    "ImagePair",
    "LpipsVgg",
    "Measures",
    "MetricWarning",
    "chamfer_dtu",
    "chamfer_points",
    "chamfer_surface",
    "cull_dtu",
    "identity",
    "lpips_vgg",
    "pair_images",
    "psnr",
    "read_dtu_scan",
    "read_image",
    "ssim",
]
