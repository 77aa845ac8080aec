# Runs main.tscn until its car is gone, then prints the deepest dent of Godot's mesh. Prints nothing if a check fails.
extends SceneTree

var main: Node
var car: MeshInstance3D
var all_holds := true


func need(holds: bool, what: String) -> void:
	if not holds:
		all_holds = false
		printerr("does not hold: " + what)


func _initialize() -> void:
	need(not CrumpleSession.new().open("tcp/127.0.0.1:1", "main", 0.1), "a session without a server is none")
	main = load("res://main.tscn").instantiate()
	car = main.get_node("Pose/Car")
	car.set_script(load("res://seen_car.gd"))
	car.timeout = 30
	root.add_child(main)
	car.drawn.connect(func() -> void: car.gone.disconnect(quit))  # main.gd would quit here
	car.gone.connect(see)


func see() -> void:
	await create_timer(0.5).timeout  # the shown surface is a tenth of a second old
	var arrays: Array = car.arrays()
	var rest: PackedVector3Array = car._session.vertices(car._asset).to_vector3_array()
	var now: PackedVector3Array = arrays[Mesh.ARRAY_VERTEX]
	var normals: PackedVector3Array = arrays[Mesh.ARRAY_NORMAL]
	var corners: PackedInt32Array = arrays[Mesh.ARRAY_INDEX]
	var deepest := 0.0
	for i in now.size():
		deepest = maxf(deepest, now[i].distance_to(rest[i]))

	# A normal must be the mean of the triangles around it, which are clockwise seen from its side.
	var sum := PackedVector3Array()
	sum.resize(now.size())
	for i in range(0, corners.size(), 3):
		var a := corners[i]
		var b := corners[i + 1]
		var c := corners[i + 2]
		for vertex: int in [a, b, c]:
			sum[vertex] += (now[c] - now[a]).cross(now[b] - now[a])
	var apart := 0.0
	for i in now.size():
		if sum[i].length() > 1e-9:
			apart = maxf(apart, sum[i].normalized().distance_to(normals[i]))
	need(apart < 1e-3, "normals: %f apart" % apart)
	var volume := 0.0  # of tetrahedra to the origin: positive if front faces point outwards
	for i in range(0, corners.size(), 3):
		volume += rest[corners[i]].dot(rest[corners[i + 2]].cross(rest[corners[i + 1]])) / 6
	need(volume > 1, "front sides look outwards: %f m^3" % volume)

	var turn: Transform3D = car.global_transform
	need((turn * Vector3(1, 0, 0)).is_equal_approx(Vector3.FORWARD), "forward")
	need((turn * Vector3(0, 1, 0)).is_equal_approx(Vector3.LEFT), "left")
	need((turn * Vector3(0, 0, 1)).is_equal_approx(Vector3.UP), "up")
	car.uploads = 0
	car._process(0)
	need(car.uploads == 0, "only what changed is uploaded")

	# A second node on the same session must draw too, although the surface no longer changes.
	var second: MeshInstance3D = car.duplicate()
	main.add_child(second)
	second._process(0)
	need(second._session == car._session and second.vertex_data == car.vertex_data, "a second node draws the same")
	need(main.get_node("Attribution").text == car.attribution and car.attribution != "", "the attribution is shown")
	quit()
	if all_holds:
		print("deepest dent %.0f mm" % (1000 * deepest))
