# Shows a car of a scene as it dents: the baked surface, or meshes of the game. It passes only the vertices that changed to the
# graphics card. Put it below the node that the game moves as the car, because it uses its own transform to convert the axes. Give
# it a material_override, or own_meshes.
class_name CrumpleCar
extends MeshInstance3D

signal drawn  # the car is drawn for the first time, or it is another car than before
signal gone  # the car was despawned, or its server is gone

@export var endpoint := "tcp/127.0.0.1:7447"
@export var scene := "main"
@export var car := "car1"
@export var timeout := 2.0  # s, for the connection; Godot stands still meanwhile
# s: the node shows the car as it was so long ago. Use the same delay for the poses: then the car moves smoothly, however
# unevenly messages come.
@export var delay := 0.1
# Nodes of the game. If there are any, this node draws no baked surface. Instead it dents every MeshInstance3D that is in this list
# or below a node in it. All of them are below the node that the game moves as the car, at their places in the car.
@export var own_meshes: Array[Node3D] = []

var attribution := ""  # must be shown where the car is shown

# Our axes are x forward, y left, z up; Godot's are -z forward, -x left, y up. Both are right-handed, so a rotation converts them.
const AXES := Basis(Vector3(0, 0, -1), Vector3(-1, 0, 0), Vector3(0, 1, 0))
const ROOM := AABB(Vector3.ONE * -10, Vector3.ONE * 20)  # m; a car fits in it, dented or not


# A surface of a mesh, of which this node changes the vertices.
class Surface:
	var mesh: ArrayMesh
	var index: int
	var count: int  # vertices
	var normals := 0  # where the normals begin in the vertex buffer: after all positions
	var stride := 0  # bytes from one normal to the next; 0: the surface has none
	var mapping := 0  # 0: the baked surface

	func _init(of: ArrayMesh, at: int) -> void:
		mesh = of
		index = at
		count = mesh.surface_get_array_len(index)
		var format := mesh.surface_get_format(index)
		if format & Mesh.ARRAY_FORMAT_NORMAL:
			normals = RenderingServer.mesh_surface_get_format_offset(format, count, Mesh.ARRAY_NORMAL)
			stride = RenderingServer.mesh_surface_get_format_normal_tangent_stride(format, count)


static var _sessions := {}  # cars of one scene share a session, as long as there are any
var _session: CrumpleSession
var _asset := ""
var _surfaces: Array[Surface] = []
var _copies := {}  # from [mesh of the game, its Transform3D to the car's frame] to the ArrayMesh that is drawn instead
var _alive := true


func _ready() -> void:
	basis = AXES
	var where := endpoint + " " + scene
	var shared: WeakRef = _sessions.get(where)
	_session = shared.get_ref() if shared else null
	if _session == null:
		_session = CrumpleSession.new()
		if not _session.open(endpoint, scene, timeout):
			set_process(false)
			return  # Godot has shown why
		_session.set_meta("mappings", {})  # all cars share them, because a session has at most 1024
		_sessions[where] = weakref(_session)
	_session.follow(car, 0)


func _process(_delta: float) -> void:
	_session.poll()
	var asset := _session.asset(car)
	if asset == "":
		return  # the drawn mesh stays
	var another := asset != _asset
	if another and not _build(asset):
		return
	var time := _session.time() - delay
	for each in _surfaces:
		var changed := _session.copy(car, time, each.mapping)
		if changed.y < 0:
			return
		if another:  # copy() names a changed vertex only once; a new mesh needs all of them
			changed = Vector2i(0, each.count)
		if changed.y > 0:
			_upload(each, 12 * changed.x, _session.positions(changed.x, changed.y))
		if changed.y > 0 and each.stride > 0:
			_upload(each, each.normals + each.stride * changed.x, _session.normals(changed.x, changed.y, each.stride))
	if another:
		_asset = asset
		drawn.emit()
	if _session.alive(car) != _alive:
		_alive = not _alive
		if not _alive:
			gone.emit()


func _upload(each: Surface, offset: int, bytes: PackedByteArray) -> void:
	each.mesh.surface_update_vertex_region(each.index, offset, bytes)


# Returns false until the undamaged car has come.
func _build(asset: String) -> bool:
	var vertices := _session.vertices(asset).to_vector3_array()
	if vertices.is_empty():
		return false
	attribution = _session.attribution(asset)
	_surfaces.clear()
	if own_meshes.is_empty():
		mesh = _baked(asset, vertices)
		_surfaces.append(Surface.new(mesh, 0))
		return true
	if _copies.is_empty():
		_take_own_meshes()
	for key: Array in _copies:
		_map(asset, key[0], key[1], _copies[key])
	return true


func _baked(asset: String, vertices: PackedVector3Array) -> ArrayMesh:
	var arrays := []
	arrays.resize(Mesh.ARRAY_MAX)
	arrays[Mesh.ARRAY_VERTEX] = vertices
	arrays[Mesh.ARRAY_NORMAL] = vertices  # makes room for normals
	arrays[Mesh.ARRAY_INDEX] = _session.triangles(asset).to_int32_array()
	var built := ArrayMesh.new()
	built.add_surface_from_arrays(Mesh.PRIMITIVE_TRIANGLES, arrays, [], {}, Mesh.ARRAY_FLAG_USE_DYNAMIC_UPDATE)
	built.custom_aabb = ROOM
	return built


# ---- meshes of the game

# Gives each MeshInstance3D of own_meshes a mesh that only this car uses.
func _take_own_meshes() -> void:
	var done := {}
	for i in own_meshes.size():
		var top := own_meshes[i]
		if top == null:
			push_error("%s: own_meshes[%d] is empty; assign a node, or remove the element" % [get_path(), i])
			continue
		if not get_parent().is_ancestor_of(top):
			push_error("%s: own_meshes[%d], %s, does not move with the car; put it below %s" %
					[get_path(), i, top.name, get_parent().name])
			continue
		var found := top.find_children("*", "MeshInstance3D", true, false)
		if top is MeshInstance3D:
			found.append(top)
		found = found.filter(func(node: MeshInstance3D) -> bool: return node.mesh != null)
		if found.is_empty():
			push_error("%s: own_meshes[%d], %s, has no mesh; assign a MeshInstance3D, or a node above one" % [get_path(), i, top.name])
		for node: MeshInstance3D in found:
			if done.has(node):
				continue
			done[node] = true
			var original: Mesh = node.mesh.get_meta("original", node.mesh)  # if another CrumpleCar dented this node before
			var key := [original, _to_car(node)]
			if not _copies.has(key):  # nodes that share a mesh in the same place share its copy
				_copies[key] = _copy_of(original)
				_copies[key].set_meta("original", original)
				_copies[key].resource_name = node.name  # for the messages
			node.mesh = _copies[key]


# From the coordinates of a node of the game to the car's frame, wherever the car is.
func _to_car(node: Node) -> Transform3D:
	var out := Transform3D()
	while node != get_parent():
		if node is Node3D:
			out = node.transform * out
		node = node.get_parent()
	return transform.affine_inverse() * out


# Only the format of its vertices may differ from that of the original: a compressed one cannot be changed.
func _copy_of(original: Mesh) -> ArrayMesh:
	var out := ArrayMesh.new()
	for i in original.get_surface_count():
		var given := RenderingServer.mesh_get_surface(original.get_rid(), i)
		var flags: int = given.format & ~Mesh.ARRAY_FLAG_COMPRESS_ATTRIBUTES | Mesh.ARRAY_FLAG_USE_DYNAMIC_UPDATE
		var lods := {}
		for lod: Dictionary in given.get("lods", []):
			lods[lod.edge_length] = _indices(lod.index_data, given.vertex_count)
		out.add_surface_from_arrays(given.primitive, original.surface_get_arrays(i), [], lods, flags)
		out.surface_set_material(i, original.surface_get_material(i))
	return out


# Godot stores indices in 16 bits if they fit.
func _indices(bytes: PackedByteArray, vertices: int) -> PackedInt32Array:
	if vertices > 65536:
		return bytes.to_int32_array()
	var out := PackedInt32Array()
	for at in range(0, bytes.size(), 2):
		out.append(bytes.decode_u16(at))
	return out


# Binds the surfaces of a mesh of the game to the baked car. Godot shows which of them does not fit.
func _map(asset: String, original: Mesh, to_car: Transform3D, copy: ArrayMesh) -> void:
	var rows := PackedFloat64Array()
	for axis in 3:
		rows.append_array([to_car.basis.x[axis], to_car.basis.y[axis], to_car.basis.z[axis], to_car.origin[axis]])
	var mappings: Dictionary = _session.get_meta("mappings")
	for i in copy.get_surface_count():
		var key := [asset, original, i, to_car]
		if not mappings.has(key):
			var arrays := original.surface_get_arrays(i)
			var lists: Array = [Mesh.ARRAY_VERTEX, Mesh.ARRAY_NORMAL, Mesh.ARRAY_TANGENT].map(
					func(kind: int) -> PackedByteArray: return arrays[kind].to_byte_array() if arrays[kind] else PackedByteArray())
			var called := "%s: surface %d of own mesh %s" % [get_path(), i, copy.resource_name]
			mappings[key] = _session.map(asset, called, lists[0], lists[1], lists[2], rows.to_byte_array())
		if mappings[key] > 0:
			copy.custom_aabb = to_car.affine_inverse() * ROOM
			_surfaces.append(Surface.new(copy, i))
			_surfaces[-1].mapping = mappings[key]
