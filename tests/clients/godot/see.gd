# Runs main.tscn until its car is gone, then prints the deepest dent of Godot's mesh. Prints nothing if a check fails.
extends SceneTree

var main: Node
var car: MeshInstance3D
var own: MeshInstance3D  # draws the car as the model
var model: Node3D
var all_holds := true
var told: Array[String] = []  # warnings and errors of Godot


class Listener:
	extends Logger
	var told: Array[String]

	func _log_error(_function: String, _file: String, _line: int, code: String, rationale: String, _editor: bool, type: int,
			_traces: Array[ScriptBacktrace]) -> void:
		told.append("%s: %s" % ["warning" if type == ERROR_TYPE_WARNING else "error", rationale if rationale else code])


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
	car.drawn.connect(see_own_at_rest)  # before main.gd prints, after which the test crashes the car
	root.add_child(main)
	car.drawn.connect(func() -> void: car.gone.disconnect(quit))  # main.gd would quit here
	car.gone.connect(see)


func see() -> void:
	await create_timer(0.5).timeout  # the shown surface is a tenth of a second old
	car._process(0)
	own._process(0)
	car.uploads = 0
	car._process(0)
	need(car.uploads == 0, "only what changed is uploaded")
	# A second node on the same session must draw too, although the surface no longer changes. It must be soon: half a second after
	# the last poll a session gives no surface.
	var second: MeshInstance3D = car.duplicate()
	main.add_child(second)
	second._process(0)
	need(second._session == car._session and second.vertex_data == car.vertex_data, "a second node draws the same")
	var again := new_car([model])
	need(again.vertex_data == own.vertex_data, "a mesh that is dented already is taken undented")
	need(again._surfaces[1].mapping == own._surfaces[1].mapping, "cars share mappings")
	need(model.body.mesh.get_meta("original") == model.given and model.body.mesh != own._surfaces[0].mesh, "and drawn anew")

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
	need(main.get_node("Attribution").text == car.attribution and car.attribution != "", "the attribution is shown")
	see_own_dented()
	quit()
	if all_holds:
		print("deepest dent %.0f mm" % (1000 * deepest))


func new_car(meshes: Array[Node3D]) -> MeshInstance3D:
	var out := MeshInstance3D.new()
	out.set_script(load("res://seen_car.gd"))
	out.endpoint = car.endpoint
	out.car = car.car
	out.own_meshes = meshes
	main.get_node("Pose").add_child(out)
	for i in 1000:
		out._process(0)
		if out._asset != "":
			break
		OS.delay_msec(10)
	need(out._asset != "", "a node with own meshes finds its car")
	return out


# A mesh of the game must have its own numbers at rest, and keep all that does not move.
func see_own_at_rest() -> void:
	if own:
		return  # drawn again, because the car is another
	var listener := Listener.new()
	listener.told = told
	OS.add_logger(listener)
	model = load("res://own.gd").new(car)
	main.get_node("Pose").add_child(model)
	var paint: Material = model.body.get_surface_override_material(1)
	own = new_car([model, model.body])
	need(own.mesh == null and own.attribution == car.attribution, "it draws no baked surface")
	need(told.is_empty(), "a mesh that fits is told nothing about: %s" % [told])
	need(own._surfaces.size() == 2, "each surface is mapped, once")
	var drawn: ArrayMesh = model.body.mesh
	need(drawn == own._surfaces[0].mesh and drawn != model.given, "the node has a mesh of its own")
	need(model.body.get_surface_override_material(1) == paint, "the node's material")
	for i in 2:
		var given: Array = model.given.surface_get_arrays(i)
		var now: Array = own.arrays(i)
		need(now[Mesh.ARRAY_VERTEX] == given[Mesh.ARRAY_VERTEX], "surface %d: positions at rest" % i)
		need(farthest(now[Mesh.ARRAY_NORMAL], given[Mesh.ARRAY_NORMAL]) < 2e-4, "surface %d: normals at rest" % i)
		need(farthest(axes(now), axes(given)) < 2e-4, "surface %d: tangents at rest" % i)
		var before := RenderingServer.mesh_get_surface(model.given.get_rid(), i)
		var after := RenderingServer.mesh_get_surface(drawn.get_rid(), i)
		need(before.lods == after.lods and after.lods.size() == 1, "surface %d: levels of detail" % i)
		need(drawn.surface_get_material(i) == model.given.surface_get_material(i), "surface %d: material" % i)

	# What does not fit is named.
	var far := box("Far", 20, 1)
	main.get_node("Pose").add_child(far)
	var flat := box("Flat", 0, 1e-6)
	main.get_node("Pose").add_child(flat)
	var outside := box("Outside", 0, 1)
	root.add_child(outside)
	var empty := Node3D.new()
	empty.name = "Empty"
	main.get_node("Pose").add_child(empty)
	new_car([null, outside, empty, far, flat]).queue_free()
	need(flat.mesh.get_meta("original") is BoxMesh and flat.mesh.get_surface_count() == 1, "a mesh that does not fit is drawn too")
	for each: String in ["error: .*own_meshes\\[0\\] is empty; assign",
			"error: .*Outside, does not move with the car; put it below Pose", "error: .*Empty, has no mesh; assign",
			"warning: .*surface 0 of own mesh Far: a vertex is \\d\\d\\.\\d\\d m away .* 0 of 24 vertices .*; move",
			"error: .*surface 0 of own mesh Flat shows no dents: to_car has no inverse.*; correct"]:
		var pattern := RegEx.create_from_string(each)
		need(told.any(func(sentence: String) -> bool: return pattern.search(sentence) != null), "%s in %s" % [each, told])
	need(told.size() == 5, "five sentences: %s" % [told])
	OS.remove_logger(listener)
	for each: Node in [far, flat, outside, empty]:
		each.queue_free()


func box(named: String, x: float, size: float) -> MeshInstance3D:
	var out := MeshInstance3D.new()
	out.name = named
	out.mesh = BoxMesh.new()
	out.position.x = x
	out.scale = Vector3.ONE * size
	return out


# A mesh of the game must end where the baked car ends.
func see_own_dented() -> void:
	var baked: Array = car.arrays()
	var rest: PackedVector3Array = car._session.vertices(car._asset).to_vector3_array()
	var now: PackedVector3Array = baked[Mesh.ARRAY_VERTEX]
	var smooth := smooth_vertices(rest, baked[Mesh.ARRAY_INDEX])
	var turned := 0
	for i in 2:
		var given: Array = model.given.surface_get_arrays(i)
		var own_now: Array = own.arrays(i)
		for kind: int in [Mesh.ARRAY_TEX_UV, Mesh.ARRAY_COLOR, Mesh.ARRAY_INDEX]:
			need(own_now[kind] == given[kind], "surface %d: what does not move" % i)
		var apart := 0.0
		var turn := 0.0
		var skew := 0.0
		var sides := 0
		var given_tangents := axes(given)
		var tangents := axes(own_now)
		for k in own_now[Mesh.ARRAY_VERTEX].size():
			var b: int = model.baked[i][k]
			var moved: Vector3 = model.to_car.basis * (own_now[Mesh.ARRAY_VERTEX][k] - given[Mesh.ARRAY_VERTEX][k])
			apart = maxf(apart, moved.distance_to(now[b] - rest[b]))
			var normal: Vector3 = own_now[Mesh.ARRAY_NORMAL][k]
			skew = maxf(skew, absf(normal.dot(tangents[k]) - given[Mesh.ARRAY_NORMAL][k].dot(given_tangents[k])))
			if smooth.has(b):
				var here: Vector3 = model.to_car.basis.orthonormalized() * normal
				turn = maxf(turn, here.distance_to(baked[Mesh.ARRAY_NORMAL][b]))
				turned += int(normal.distance_to(given[Mesh.ARRAY_NORMAL][k]) > 0.1)
			sides += int(own_now[Mesh.ARRAY_TANGENT][4 * k + 3] != given[Mesh.ARRAY_TANGENT][4 * k + 3])
		need(apart < 1e-5, "surface %d: %f m from the server's surface" % [i, apart])
		need(turn < 5e-3, "surface %d: normals %f from those of the server's surface" % [i, turn])
		need(sides == 0, "surface %d: %d binormals changed sides" % [i, sides])
		need(skew < 1e-3, "surface %d: tangents turn with the normals, within %f" % [i, skew])
	need(smooth.size() > rest.size() / 2 and turned > 100, "normals to compare: %d, turned: %d" % [smooth.size(), turned])


# The vertices that are alone in their place, and of which every triangle is less than 60 degrees from the mean: there the library
# turns a mean normal with all of them.
func smooth_vertices(at: PackedVector3Array, corners: PackedInt32Array) -> Dictionary:
	var crosses := {}
	for i in range(0, corners.size(), 3):
		var cross := (at[corners[i + 2]] - at[corners[i]]).cross(at[corners[i + 1]] - at[corners[i]])
		for k in 3:
			crosses.get_or_add(corners[i + k], PackedVector3Array()).append(cross)
	var places := {}
	for each in at:
		places[each.snappedf(1e-3)] = places.get(each.snappedf(1e-3), 0) + 1
	var out := {}
	for vertex: int in crosses:
		var mean := Vector3()
		for each: Vector3 in crosses[vertex]:
			mean += each
		var least := 1.0
		for each: Vector3 in crosses[vertex]:
			least = minf(least, each.normalized().dot(mean.normalized()))
		if least > 0.51 and places[at[vertex].snappedf(1e-3)] == 1:
			out[vertex] = true
	return out


func axes(arrays: Array) -> PackedVector3Array:
	var tangents: PackedFloat32Array = arrays[Mesh.ARRAY_TANGENT]
	var out := PackedVector3Array()
	for i in range(0, tangents.size(), 4):
		out.append(Vector3(tangents[i], tangents[i + 1], tangents[i + 2]))
	return out


func farthest(a: PackedVector3Array, b: PackedVector3Array) -> float:
	var out := 0.0
	for i in a.size():
		out = maxf(out, a[i].distance_to(b[i]))
	return out
