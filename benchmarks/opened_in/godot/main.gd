# Shows model.glb, as the editor imported it, from the camera of view.json, and writes picture.png.
extends Spatial

func _ready():
	var file = File.new()
	file.open("res://view.json", File.READ)
	var view = JSON.parse(file.get_as_text()).result
	var scene = load("res://model.glb")
	if scene == null:
		OS.exit_code = 1
		get_tree().quit()
		return
	var model = scene.instance()
	add_child(model)
	if view.mended:
		unlight(model)
	var camera = Camera.new()
	add_child(camera)
	camera.set_perspective(view.degrees, view.near, view.far)
	camera.look_at_from_position(point(view.eye), point(view.target), Vector3(0, 1, 0))
	camera.current = true
	for _frame in range(5):
		yield(VisualServer, "frame_post_draw")
	var picture = get_viewport().get_texture().get_data()
	picture.flip_y()
	picture.save_png("res://picture.png")
	print("drawn by ", VisualServer.get_video_adapter_name())
	get_tree().quit()

func unlight(node):
	if node is MeshInstance:
		for surface in range(node.mesh.get_surface_count()):
			var material = node.mesh.surface_get_material(surface)
			material.flags_unshaded = true
			material.vertex_color_use_as_albedo = true
	for child in node.get_children():
		unlight(child)

func point(values):
	return Vector3(values[0], values[1], values[2])
