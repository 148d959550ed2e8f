"""Read and write USD stages as other USD programs show them: materials, primvars, units and composition."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from msb.asset.look import colors_of
from msb.base.children import Reply
from msb.meshes import Mesh, read_mesh, usd
from msb.meshes.assets import asset_from_mesh
from msb.meshes.files import write_whole
from msb.meshes.usd_looks import list_lost, list_stored

from .builders import picture

pytest.importorskip("pxr", reason="usd-core, of the extra usd, is not installed")


@pytest.fixture(autouse=True)
def read_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Save the time that child processes take to start."""
    monkeypatch.setattr(usd, "run_in_child", lambda work, word, arrays, _: Reply(*work(word, arrays)))


# Two squares side by side, with separate texture coordinates.
MESH = """ def Mesh "m" (prepend apiSchemas = ["MaterialBindingAPI"]) {
  int[] faceVertexCounts = [4, 4]
  int[] faceVertexIndices = [0, 1, 2, 3, 1, 4, 5, 2]
  point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0), (2, 1, 0)]
  texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (0, 1)] (interpolation = "vertex")
  uniform token subdivisionScheme = "none"
  rel material:binding = </q/mat>
%s }
"""
MATERIAL = """ def Material "%s" {
  token outputs:surface.connect = </q/%s/s.outputs:surface>
  def Shader "s" {
   uniform token info:id = "UsdPreviewSurface"
   %s
   token outputs:surface
  }
%s
 }
"""
READER = """  def Shader "st" {
   uniform token info:id = "UsdPrimvarReader_float2"
   string inputs:varname = "st"
   float2 outputs:result
  }
"""
TEXTURE = """  def Shader "tex" {
   uniform token info:id = "UsdUVTexture"
   asset inputs:file = @t.png@
   float2 inputs:st.connect = </q/mat/st.outputs:result>
   %s
   float3 outputs:rgb
   float outputs:a
  }
"""
TEXTURED = "color3f inputs:diffuseColor.connect = </q/mat/tex.outputs:rgb>"
TEXEL = (200, 40, 40)


def stage(body: str, head: str = "metersPerUnit = 1") -> str:
    return f'#usda 1.0\n(\n defaultPrim = "q"\n {head}\n)\ndef Xform "q" {{\n{body}}}\n'


def material(surface: str, inside: str = "", name: str = "mat") -> str:
    return MATERIAL % (name, name, surface, inside)


def read(text: str, folder: Path, texels: object = None) -> Mesh:
    """Return the mesh of a stage beside the image t.png."""
    (folder / "t.png").write_bytes(picture(np.full((2, 2, 3), TEXEL, np.uint8) if texels is None else texels))
    path = folder / "a.usda"
    path.write_text(text)
    return read_mesh(path)


def colors(mesh: Mesh) -> list[list[int]]:
    """Return the sRGB colour (n, 3) of each face in bytes, averaged over its corners."""
    shown = colors_of(asset_from_mesh(mesh))
    assert shown is not None
    values = shown.values[:, :3] / (255 if shown.values.dtype == np.uint8 else 1)
    if shown.domain == "vertex":
        values = values[mesh.faces].reshape(-1, 3)
    by_face = values if shown.domain == "face" else values.reshape(-1, 3, 3).mean(axis=1)
    return np.rint(255 * by_face).astype(int).tolist()


def srgb(*light: float) -> list[int]:
    """Return linear light as sRGB bytes."""
    from msb.asset.texture import linear_to_srgb

    return np.rint(255 * linear_to_srgb(np.array(light, np.float64))).astype(int).tolist()


FOLLOWED = {
    "a value of the material": (
        "color3f inputs:diffuseColor.connect = </q/mat.inputs:c>",
        "color3f inputs:c = (0, 1, 0)",
    ),
    "a graph in the material": (
        "color3f inputs:diffuseColor.connect = </q/mat/g.outputs:o>",
        """color3f inputs:c = (0, 1, 0)
  def NodeGraph "g" {
   color3f inputs:i.connect = </q/mat.inputs:c>
   color3f outputs:o.connect = </q/mat/g.inputs:i>
  }""",
    ),
    "an interface without a value": (
        "color3f inputs:diffuseColor = (0, 1, 0)\n color3f inputs:diffuseColor.connect = </q/mat.inputs:c>",
        "color3f inputs:c",
    ),
    "a circle that ends in a value": (
        "color3f inputs:diffuseColor.connect = </q/mat.inputs:c>",
        "color3f inputs:c = (0, 1, 0)\n color3f inputs:c.connect = </q/mat.inputs:d>\n"
        "color3f inputs:d.connect = </q/mat.inputs:c>",
    ),
    "unlit": ("color3f inputs:diffuseColor = (0, 0, 0)\n color3f inputs:emissiveColor = (0, 1, 0)", ""),
}


@pytest.mark.parametrize("case", FOLLOWED)
def test_the_colour_is_where_the_connections_end(case: str, tmp_path: Path) -> None:
    surface, inside = FOLLOWED[case]
    red = '  color3f[] primvars:displayColor = [(1, 0, 0)] (interpolation = "constant")\n'
    mesh = read(stage(MESH % red + material(surface, inside)), tmp_path)
    assert colors(mesh) == [[0, 255, 0]] * 4


@pytest.mark.parametrize(
    "name", ["file", "varname", "wrapS", "scale", "sourceColorSpace", "opacityThreshold"]
)
def test_inputs_of_textures_are_followed_through_several_interfaces(name: str, tmp_path: Path) -> None:
    """In one stage each input is direct.

    In the other it passes through a graph and two inputs of the material.
    """
    values = {
        "file": ("asset", "@t.png@"),
        "varname": ("string", '"st"'),
        "wrapS": ("token", '"mirror"'),
        "scale": ("float4", "(0.5, 0.25, 1, 1)"),
        "sourceColorSpace": ("token", '"raw"'),
        "opacityThreshold": ("float", "0.25"),
    }
    kind, value = values[name]
    texels = np.full((2, 2, 4), (*TEXEL, 128), np.uint8)
    alpha = "float inputs:opacity.connect = </q/mat/tex.outputs:a>"
    direct = f"{kind} inputs:{name} = {value}"
    surface = f"{TEXTURED}\n{alpha}" + (f"\n{direct}" if name == "opacityThreshold" else "")
    texture = TEXTURE % (direct if name not in ("file", "varname", "opacityThreshold") else "")
    plain = stage(MESH % "" + material(surface, READER + texture))
    behind = plain.replace(direct, f"{kind} inputs:{name}.connect = </q/mat.inputs:one>").replace(
        ' def Material "mat" {\n',
        f' def Material "mat" {{\n  {kind} inputs:two = {value}\n'
        f"  {kind} inputs:one.connect = </q/mat/g.outputs:o>\n"
        f'  def NodeGraph "g" {{\n   {kind} inputs:i.connect = </q/mat.inputs:two>\n'
        f"   {kind} outputs:o.connect = </q/mat/g.inputs:i>\n  }}\n",
    )
    assert behind != plain
    first, second = read(plain, tmp_path, texels), read(behind, tmp_path, texels)
    assert len(first.textures) == 1
    assert first.sampler == second.sampler
    np.testing.assert_array_equal(first.textures, second.textures)
    np.testing.assert_array_equal(first.vertex_uvs, second.vertex_uvs)
    assert colors(first) == colors(second)
    assert (first.sampler.alpha_cutoff, first.sampler.wrap_u) == (
        0.25 if name == "opacityThreshold" else None,
        "mirror" if name == "wrapS" else "repeat",
    )


def test_scale_bias_and_raw_texels_are_applied(tmp_path: Path) -> None:
    light = [0.57758, 0.02122, 0.02122]  # TEXEL
    for inputs, expected in (
        ("float4 inputs:scale = (0.5, 0.25, 1, 1)", (light[0] / 2, light[1] / 4, light[2])),
        ("float4 inputs:scale = (2, 2, 2, 1)", (1, light[1] * 2, light[2] * 2)),
        ("float4 inputs:bias = (-1, 0.5, 0, 0)", (0, light[1] + 0.5, light[2])),
        ('token inputs:sourceColorSpace = "raw"', (200 / 255, 40 / 255, 40 / 255)),
        ("float4 inputs:scale = (nan, 1, 1, 1)", light),
    ):
        mesh = read(stage(MESH % "" + material(TEXTURED, READER + TEXTURE % inputs)), tmp_path)
        assert np.abs(np.array(colors(mesh)) - srgb(*expected)).max() <= 1, inputs


def test_transforms_of_textures_move_the_coordinates(tmp_path: Path) -> None:
    moved = """  def Shader "move" {
   uniform token info:id = "UsdTransform2d"
   float2 inputs:in.connect = </q/mat/st.outputs:result>
   float2 inputs:scale = (2, 4)
   float inputs:rotation = 90
   float2 inputs:translation = (0.5, 0)
   float2 outputs:result
  }
"""
    texture = (TEXTURE % "").replace("mat/st.", "mat/move.")
    mesh = read(stage(MESH % "" + material(TEXTURED, READER + moved + texture)), tmp_path)
    # (1, 0) becomes (2, 0), then (0, 2), then (0.5, 2). In the result, v points downwards.
    assert mesh.vertex_uvs is not None
    np.testing.assert_allclose(mesh.vertex_uvs[[0, 1, 3]], [[0.5, 1], [0.5, -1], [-3.5, 1]], atol=1e-6)


SUBSET = """  def GeomSubset "of_%s" (prepend apiSchemas = ["MaterialBindingAPI"]) {
   uniform token elementType = "face"
   uniform token familyName = "materialBind"
   int[] indices = [1]
   rel material:binding = </q/%s>
  }
"""


def test_each_material_of_a_mesh_keeps_its_colour(tmp_path: Path) -> None:
    """One square has a texture. The other has a uniform colour, a primvar or no texture coordinates."""
    shown = '  color3f[] primvars:displayColor = [(0, 0, 1)] (interpolation = "constant")\n'
    reader = """  def Shader "read" {
   uniform token info:id = "UsdPrimvarReader_float3"
   string inputs:varname = "%s"
   float3 inputs:fallback = (0, 1, 0)
   float3 outputs:result
  }
"""
    from_reader = "color3f inputs:diffuseColor.connect = </q/other/read.outputs:result>"
    unmapped = material(TEXTURED, (READER + TEXTURE % "").replace('"st"\n', '"none"\n')).replace(
        "q/mat", "q/other"
    )
    cases = {
        material("color3f inputs:diffuseColor = (0, 1, 0)", name="other"): srgb(0, 1, 0),
        material("", name="other"): srgb(0.18, 0.18, 0.18),
        material(from_reader, reader % "displayColor", "other"): srgb(0, 0, 1),
        material(from_reader, reader % "missing", "other"): srgb(0, 1, 0),
        unmapped.replace('"mat"', '"other"'): srgb(0, 0, 1),
    }
    for other, expected in cases.items():
        body = (
            MESH % (shown + SUBSET % ("other", "other")) + material(TEXTURED, READER + TEXTURE % "") + other
        )
        mesh = read(stage(body), tmp_path)
        assert colors(mesh) == [list(TEXEL)] * 2 + [expected] * 2, other
        assert ("textures without UVs" in mesh.left_out) == ('"none"' in other)


@pytest.mark.parametrize(
    ("domain", "values", "expected"),
    [
        ("constant", "[(5, 0.5, -1)]", [(1, 0.5, 0)] * 4),
        ("uniform", "[(1.00001, 0, 0), (nan, inf, 0)]", [(1, 0, 0)] * 2 + [(0, 1, 0)] * 2),
        ("vertex", "[(7, 0, 0), (7, 0, 0), (7, 0, 0), (7, 0, 0), (7, 0, 0), (7, 0, 0)]", [(1, 0, 0)] * 4),
        (
            "faceVarying",
            f"[{', '.join(['(0, -2, 0)'] * 4 + ['(0, 3, 0)'] * 4)}]",
            [(0, 0, 0)] * 2 + [(0, 1, 0)] * 2,
        ),
    ],
)
def test_colours_are_clamped(domain: str, values: str, expected: list[object], tmp_path: Path) -> None:
    shown = f'  color3f[] primvars:displayColor = {values} (interpolation = "{domain}")\n'
    mesh = read(stage((MESH % shown).replace("  rel material:binding = </q/mat>\n", "")), tmp_path)
    assert colors(mesh) == [srgb(*color) for color in expected]  # type: ignore[misc]
    if domain == "constant":
        diffuse = material("color3f inputs:diffuseColor = (5, nan, -1)")
        assert colors(read(stage(MESH % "" + diffuse), tmp_path)) == [[255, 0, 0]] * 4


def test_indexed_colours_of_every_domain_are_read(tmp_path: Path) -> None:
    for domain, numbers in (("uniform", [1, 0]), ("vertex", [1] * 6), ("faceVarying", [1] * 4 + [0] * 4)):
        shown = (
            f'  color3f[] primvars:displayColor = [(0, 1, 0), (1, 0, 0)] (interpolation = "{domain}")\n'
            f"  int[] primvars:displayColor:indices = {numbers}\n"
        )
        mesh = read(stage((MESH % shown).replace("  rel material:binding = </q/mat>\n", "")), tmp_path)
        second = [255, 0, 0] if domain == "vertex" else [0, 255, 0]
        assert colors(mesh) == [[255, 0, 0]] * 2 + [second] * 2


@pytest.mark.parametrize(
    "lines",
    ["", *(f"texCoord2f[] primvars:st = {uvs} (interpolation = 'vertex')" for uvs in ("[]", "[(0, 0)]"))],
)
def test_textures_without_coordinates_are_left_out(lines: str, tmp_path: Path) -> None:
    body = MESH % "" + material(TEXTURED, READER + TEXTURE % "")
    text = "".join(f"{lines if 'texCoord2f' in line else line}\n" for line in stage(body).splitlines())
    mesh = read(text, tmp_path)
    assert (mesh.textures, mesh.vertex_uvs) == ((), None)
    assert "textures without UVs" in mesh.left_out
    asset_from_mesh(mesh)


def test_missing_images_are_left_out_by_name(tmp_path: Path) -> None:
    for name in ("gone.png", "../t.png", "/etc/passwd", "a.usda"):
        texture = (TEXTURE % "").replace("t.png", name)
        mesh = read(stage(MESH % "" + material(TEXTURED, READER + texture)), tmp_path)
        assert mesh.textures == ()
        assert [name in part for part in mesh.left_out] == [True]


def test_opacity_cuts_out_only_by_the_alpha_of_the_image(tmp_path: Path) -> None:
    alpha = "\n float inputs:opacity.connect = </q/mat/tex.outputs:a>"
    cut = "\n float inputs:opacityThreshold = 0.5"
    texels = np.full((2, 2, 4), (*TEXEL, 128), np.uint8)
    for surface, cutoff, left_out in (
        (alpha + cut, 0.5, ()),
        (alpha, None, ("alpha blending",)),
        (cut, None, ()),
        ("\n float inputs:opacity = 0.7" + cut, None, ()),
        ("\n float inputs:opacity = 0.7", None, ("opacity of materials",)),
        ("\n float inputs:opacity = 0.2" + cut, None, ("opacity of materials",)),
        (alpha.replace(":a>", ":rgb>") + cut, None, ("opacity maps",)),
        (alpha + cut.replace("0.5", "nan"), None, ("alpha blending",)),
    ):
        mesh = read(stage(MESH % "" + material(TEXTURED + surface, READER + TEXTURE % "")), tmp_path, texels)
        assert (mesh.sampler.alpha_cutoff, mesh.left_out) == (cutoff, left_out), surface
        assert mesh.textures[0].shape[2] == (4 if cutoff else 3)


UNITS = [
    ("metersPerUnit = 1", 1.0),
    ("metersPerUnit = 0.01", 0.01),
    ("metersPerUnit = 0.0254", 0.0254),
    ("metersPerUnit = 1000", 1000.0),
    ("", 0.01),
    ("metersPerUnit = 0", None),
    ("metersPerUnit = -1", None),
    ("metersPerUnit = nan", None),
    ("metersPerUnit = inf", None),
]


@pytest.mark.parametrize(("head", "unit"), UNITS)
def test_positions_are_in_metres(head: str, unit: float | None, tmp_path: Path) -> None:
    body = (MESH % "").replace("  rel material:binding = </q/mat>\n", "")
    mesh = read(stage(body, f'{head}\n upAxis = "Z"'), tmp_path)
    # An invalid unit is reported, and replaced by the default of USD, the centimetre.
    assert [part.startswith("metersPerUnit") for part in mesh.left_out] == [True] * (unit is None)
    assert (mesh.up, mesh.meters_per_unit) == ("+z", unit or 0.01)
    np.testing.assert_array_equal(np.ptp(mesh.vertices, axis=0), np.array([2, 1, 0]) * (unit or 0.01))
    assert mesh.vertices.dtype == (np.float32 if unit == 1 else np.float64)


def test_references_to_the_same_file_are_read(tmp_path: Path) -> None:
    part = (MESH % "").replace("  rel material:binding = </q/mat>\n", "")
    arcs = ("references = </Part>", "payload = </Part>", "inherits = </Part>\n instanceable = true")
    copies = [f'def Xform "{name}" (\n {arc}\n) {{\n}}\n' for name, arc in zip("abc", arcs, strict=True)]
    variants = f"""def Xform "v" (
 variants = {{
  string kind = "two"
 }}
 prepend variantSets = "kind"
) {{
 variantSet "kind" = {{
  "one" {{
{part}  }}
  "two" {{
{part}{part.replace('"m"', '"n"')}  }}
 }}
}}
"""
    abstract = f'class "Part" {{\n{part}}}\nover "O" {{\n{part}}}\n'
    undrawn = "".join(
        f'def Scope "{name}" {{\n {line}\n{part}}}\n'
        for name, line in (("g", 'uniform token purpose = "guide"'), ("i", 'token visibility = "invisible"'))
    )
    mesh = read(
        "#usda 1.0\n(\n metersPerUnit = 1\n)\n" + abstract + "".join(copies) + variants + undrawn, tmp_path
    )
    assert len(mesh.faces) == 4 * 5
    assert mesh.left_out == ("guides and proxies",)
    missing = copies[0].replace("</Part>", "</Gone>").replace('"a"', '"z"')
    mesh = read("#usda 1.0\n" + abstract + missing + copies[0], tmp_path)
    assert (len(mesh.faces), mesh.left_out) == (4, ("references that cannot be resolved",))


def tinted(tint: np.ndarray | None, domain: str = "face", texels: object = ((255, 255, 255),)) -> Mesh:
    """Return four separate triangles.

    Two have an image, and two have another texture, the texels (1, 1, 3).
    """
    rng = np.random.default_rng(5)
    image = rng.integers(0, 256, (4, 4, 3), np.uint8)
    return Mesh(
        rng.random((12, 3), np.float32),
        np.arange(12).reshape(4, 3),
        vertex_colors=tint if domain == "vertex" else None,
        face_colors=tint if domain == "face" else None,
        vertex_uvs=rng.random((12, 2), np.float32).round(2),
        textures=(image, np.array([texels], np.uint8)),
        face_textures=np.array([0, 0, 1, 1], np.uint32),
    )


RED, WHITE, PINK = [255, 0, 0], [255, 255, 255], [250, 120, 130]
RANDOM = np.random.default_rng(6).integers(0, 256, (12, 3), np.uint8)
# The meshes by name, with their stored parts and their lost parts.
TINTED = {
    "no colours": (tinted(None), ["1 texture"], []),
    "plain": (tinted(np.uint8([WHITE, WHITE, RED, RED])), ["1 texture", "1 material colour"], []),
    "both": (tinted(np.uint8([PINK, RED, RED, PINK])), ["1 texture", "2 material colours"], []),
    "vertices": (
        tinted(np.uint8([WHITE] * 6 + RANDOM[:6].tolist()), "vertex"),
        ["1 texture", "vertex colours"],
        [],
    ),
    "texels": (
        tinted(np.float32([[0.5, 0.25, 1]] * 6 + [[0.1, 0.7, 0.3]] * 3 + [[1, 0, 0.5]] * 3), "vertex", [RED]),
        ["1 texture", "3 material colours"],
        [],
    ),
    "texels and vertices": (
        tinted(np.uint8([PINK] * 6 + RANDOM[:6].tolist()), "vertex", [PINK]),
        ["1 texture", "1 material colour", "vertex colours"],
        [],
    ),
    "opacity": (
        tinted(np.uint8([[*WHITE, 255], [*WHITE, 7], [*RED, 255], [*RED, 255]])),
        ["1 texture", "1 material colour"],
        ["opacity of colours"],
    ),
    "uneven": (
        tinted(RANDOM, "vertex"),
        ["1 texture", "1 material colour", "vertex colours"],
        ["colours that vary over a texture (their average is stored)"],
    ),
}


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
@pytest.mark.parametrize("name", TINTED)
def test_colours_beside_textures_are_written(name: str, suffix: str, tmp_path: Path) -> None:
    (mesh, stored, lost), path = TINTED[name], tmp_path / f"a{suffix}"
    assert (list_stored(mesh), list_lost(mesh)) == (stored, lost)
    write_whole(mesh, path)
    again = read_mesh(path)
    faces = slice(0 if name != "uneven" else 2, None)
    assert np.abs(np.array(colors(again)) - colors(mesh))[faces].max() <= 1
    np.testing.assert_array_equal(again.vertices[again.faces], mesh.vertices[mesh.faces])
    # A texture of one texel becomes a colour, so only the image is written beside the stage.
    images = ["a_0.png"] if suffix == ".usda" else []
    assert sorted(file.name for file in tmp_path.iterdir()) == [path.name, *images]


def test_one_texel_textures_alone_need_no_image(tmp_path: Path) -> None:
    mesh = tinted(np.uint8([PINK, RED, RED, PINK]))
    mesh = replace(mesh, textures=(np.uint8([[PINK]]), np.uint8([[RED]])))
    write_whole(mesh, tmp_path / "a.usda")
    assert [file.name for file in tmp_path.iterdir()] == ["a.usda"]
    assert colors(read_mesh(tmp_path / "a.usda")) == colors(mesh)


def test_many_colours_share_one_material(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    count = 200
    mesh = Mesh(
        rng.random((3 * count, 3), np.float32),
        np.arange(3 * count).reshape(-1, 3),
        face_colors=rng.integers(0, 256, (count, 3), np.uint8),
        vertex_uvs=rng.random((3 * count, 2), np.float32),
        textures=(np.zeros((2, 2, 3), np.uint8), np.full((1, 1, 3), 255, np.uint8)),
        face_textures=(np.arange(count) > 50).astype(np.uint32),
    )
    path = tmp_path / "a.usda"
    write_whole(mesh, path)
    assert path.read_text().count("def Material") == 52
    assert np.abs(np.array(colors(read_mesh(path))) - colors(mesh)).max() <= 1
