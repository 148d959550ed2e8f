@tool
class_name TriassetModel
extends MultiMeshInstance3D
## Draws a Triangle-Splatting model from a packed .triasset, like the official renderer.
##
## The buffers of the file become textures unchanged. The shader projects every triangle and draws a quad over the
## covered samples. This script sorts the triangles when the camera has moved. The shader needs Godot's
## renderer Compatibility, which blends display colours. Use a GLB for other methods and for the standard tier.

const SHADER := preload("triangle_splatting.gdshader")
const COLUMNS := 4096  # texels in a row of each texture
const CHANNELS := {"positions": 3, "f_dc": 3, "f_rest": 3, "opacity": 1, "sigma": 1}

## The file. In an exported game, add *.triasset to the filters of the resources to export.
@export_file("*.triasset") var path := "": set = open

var manifest := {}
var _centers := PackedVector3Array()
var _numbers := PackedInt32Array()  # face numbers: the bits of float32 values
var _order: ImageTexture
var _sorted_for := Plane()


## Reads the file. Returns true if the model can be drawn.
func open(value: String) -> bool:
	path = value
	multimesh = null
	var buffers := read(value)
	if buffers.is_empty():
		return false
	if manifest.method != "triangle_splatting":
		push_error("%s: its method is %s; only triangle_splatting can be drawn" % [value, manifest.method])
		return false
	var faces := int(manifest.face_count)
	var material := ShaderMaterial.new()
	material.shader = SHADER
	for name in buffers:
		material.set_shader_parameter(name, _make_texture(buffers[name], CHANNELS[name]))
	material.set_shader_parameter("degree", int(manifest.settings.sh_degree.value) if "f_rest" in buffers else 0)
	material.set_shader_parameter("stored", (int(manifest.sh_degree) + 1) ** 2 - 1)
	material.set_shader_parameter("broadcast_z", manifest.settings.view_dir.value == "broadcast_z")
	# Compute the centroids and numbers of the faces for sorting.
	var corners := (buffers.positions as PackedByteArray).to_float32_array()
	_centers.resize(faces)
	var numbers := PackedFloat32Array()
	numbers.resize(faces)
	for face in faces:
		var at := 9 * face
		_centers[face] = Vector3(
			corners[at] + corners[at + 3] + corners[at + 6],
			corners[at + 1] + corners[at + 4] + corners[at + 7],
			corners[at + 2] + corners[at + 5] + corners[at + 8]) / 3.0
		numbers[face] = face
	_numbers = numbers.to_byte_array().to_int32_array()
	_order = null
	_sorted_for = Plane()
	# Make one quad for each face.
	var quad := QuadMesh.new()
	quad.size = Vector2(2, 2)
	quad.material = material
	var many := MultiMesh.new()
	many.transform_format = MultiMesh.TRANSFORM_3D
	many.mesh = quad
	many.instance_count = faces
	multimesh = many
	var least := _to_vector(manifest.bounds.min)
	custom_aabb = AABB(least, _to_vector(manifest.bounds.max) - least)
	return true


## Returns the bytes of the drawn buffers by name, and sets `manifest`. The result of an unreadable file is empty.
func read(value: String) -> Dictionary:
	var file := ZIPReader.new()
	var buffers := {}
	if value.is_empty() or file.open(value) != OK:
		if not value.is_empty():
			push_error("%s: it is not a packed .triasset" % value)
		return buffers
	var parsed: Variant = JSON.parse_string(file.read_file("manifest.json").get_string_from_utf8())
	if not parsed is Dictionary or parsed.get("format") != "triasset" or not str(parsed.version).begins_with("1."):
		push_error("%s: its manifest is not of a .triasset of version 1" % value)
		return buffers
	manifest = parsed
	for name in CHANNELS:
		if name in manifest.buffers:
			var about: Dictionary = manifest.buffers[name]
			buffers[name] = file.read_file(about.file).slice(int(about.offset), int(about.offset) + int(about.byte_length))
	return buffers


func _process(_delta: float) -> void:
	if multimesh != null:
		var viewport: Viewport = get_viewport()
		if Engine.is_editor_hint():
			viewport = Engine.get_singleton("EditorInterface").get_editor_viewport_3d()
		if viewport.get_camera_3d() != null:
			sort_for(viewport.get_camera_3d())


## Sorts the faces by the depth of their centroids, the farthest first, if the camera has moved.
func sort_for(camera: Camera3D) -> void:
	var material: ShaderMaterial = multimesh.mesh.surface_get_material(0)
	material.set_shader_parameter("model_to_world", global_transform)
	# Compute depth as the distance from a plane in model space: normal . center - d.
	var forward := -camera.global_transform.basis.z.normalized()
	var normal := global_transform.basis.transposed() * forward
	var plane := Plane(normal, forward.dot(camera.global_position - global_position))
	if plane == _sorted_for:
		return
	_sorted_for = plane
	var faces := _centers.size()
	var depths := PackedFloat32Array()
	depths.resize(faces)
	for face in faces:
		depths[face] = normal.dot(_centers[face]) - plane.d
	# The bits of positive floats sort like integers. A key has the depth in its high bits and the face number in its low
	# bits, so faces of equal depth keep the order of the file. The whole order is then reversed.
	var bits := depths.to_byte_array().to_int32_array()
	var keys := PackedInt64Array()
	keys.resize(faces)
	for face in faces:
		keys[face] = (bits[face] << 32) | _numbers[face]
	keys.sort()
	keys.reverse()
	var image := _make_image(keys.to_byte_array(), 2)
	if _order == null:
		_order = ImageTexture.create_from_image(image)
		material.set_shader_parameter("order", _order)
	else:
		_order.update(image)


func _to_vector(values: Array) -> Vector3:
	return Vector3(values[0], values[1], values[2])


func _make_texture(bytes: PackedByteArray, channels: int) -> ImageTexture:
	return ImageTexture.create_from_image(_make_image(bytes, channels))


## Returns float32 values as an image; the last row is padded with zeros.
func _make_image(bytes: PackedByteArray, channels: int) -> Image:
	var row := COLUMNS * channels * 4
	var rows := maxi(1, ceili(float(bytes.size()) / row))
	bytes.resize(rows * row)
	var formats := {1: Image.FORMAT_RF, 2: Image.FORMAT_RGF, 3: Image.FORMAT_RGBF}
	return Image.create_from_data(COLUMNS, rows, false, formats[channels], bytes)
