"""The method "mesh": any mesh that no supported method has written."""

from msb.registry import NO_APPEARANCE, Method

METHOD = Method(
    title="mesh",
    unsupported={"reference": NO_APPEARANCE, "dedicated": NO_APPEARANCE},
    passes={"standard": ("opaque_unlit",)},
)
