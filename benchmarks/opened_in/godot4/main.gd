# Draws model.triasset with the add-on for each view that the page gives, and answers with the pixels.
extends Node

var _picture := SubViewport.new()
var _camera := Camera3D.new()


func _ready() -> void:
	_picture.render_target_update_mode = SubViewport.UPDATE_ALWAYS
	_picture.own_world_3d = true
	add_child(_picture)
	_picture.add_child(_camera)
	var model := TriassetModel.new()
	_picture.add_child(model)
	var opened := model.open("res://model.triasset")
	JavaScriptBridge.eval("started(%s)" % JSON.stringify({
		"opened": opened, "godot": Engine.get_version_info().string, "device": RenderingServer.get_video_adapter_name(),
		"faces": model.manifest.get("face_count", 0),
	}))
	while opened:
		await get_tree().process_frame
		var view: Variant = JSON.parse_string(str(JavaScriptBridge.eval("JSON.stringify(take())")))
		if view is Dictionary:
			await draw(view)


func draw(view: Dictionary) -> void:
	_picture.size = Vector2i(view.width, view.height)
	RenderingServer.set_default_clear_color(Color(view.background[0], view.background[1], view.background[2]))
	_camera.set_perspective(view.degrees, 0.01, 1000.0)
	var rows: Array = view.world_to_camera
	var right := _to_vector(rows[0])
	var down := _to_vector(rows[1])
	var forward := _to_vector(rows[2])
	var eye: Vector3 = -(right * rows[0][3] + down * rows[1][3] + forward * rows[2][3])
	_camera.global_transform = Transform3D(Basis(right, -down, -forward), eye)
	for frame in 4:
		await RenderingServer.frame_post_draw
	var image := _picture.get_texture().get_image()
	image.convert(Image.FORMAT_RGB8)
	JavaScriptBridge.eval("give('%s')" % Marshalls.raw_to_base64(image.get_data()))


func _to_vector(row: Array) -> Vector3:
	return Vector3(row[0], row[1], row[2])
