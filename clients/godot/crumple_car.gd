# Shows a car of a scene as it dents. It passes only the vertices that changed to the graphics card. Put it below the node that
# the game moves as the car, because it uses its own transform to convert the axes. Give it a material_override.
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

var attribution := ""  # must be shown where the car is shown

# Our axes are x forward, y left, z up; Godot's are -z forward, -x left, y up. Both are right-handed, so a rotation converts them.
const AXES := Basis(Vector3(0, 0, -1), Vector3(-1, 0, 0), Vector3(0, 1, 0))

static var _sessions := {}  # cars of one scene share a session, as long as there are any
var _session: CrumpleSession
var _asset := ""
var _count := 0  # vertices
var _normals := 0  # where the normals begin in the vertex buffer: after all positions
var _stride := 0  # bytes from one normal to the next
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
	var changed := _session.copy(car, _session.time() - delay)
	if changed.y < 0:
		return
	if another:  # copy() names a changed vertex only once; a new mesh needs all of them
		changed = Vector2i(0, _count)
		_asset = asset
	if changed.y > 0:
		_upload(12 * changed.x, _session.positions(changed.x, changed.y))
		_upload(_normals + _stride * changed.x, _session.normals(changed.x, changed.y, _stride))
	if another:
		drawn.emit()
	if _session.alive(car) != _alive:
		_alive = not _alive
		if not _alive:
			gone.emit()


func _upload(offset: int, bytes: PackedByteArray) -> void:
	mesh.surface_update_vertex_region(0, offset, bytes)


# Returns false until the undamaged car has come.
func _build(asset: String) -> bool:
	var vertices := _session.vertices(asset).to_vector3_array()
	if vertices.is_empty():
		return false
	var arrays := []
	arrays.resize(Mesh.ARRAY_MAX)
	arrays[Mesh.ARRAY_VERTEX] = vertices
	arrays[Mesh.ARRAY_NORMAL] = vertices  # makes room for normals
	arrays[Mesh.ARRAY_INDEX] = _session.triangles(asset).to_int32_array()
	var built := ArrayMesh.new()
	built.add_surface_from_arrays(Mesh.PRIMITIVE_TRIANGLES, arrays, [], {}, Mesh.ARRAY_FLAG_USE_DYNAMIC_UPDATE)
	built.custom_aabb = AABB(Vector3.ONE * -10, Vector3.ONE * 20)  # m; a car fits in it, dented or not
	_count = vertices.size()
	_normals = RenderingServer.mesh_surface_get_format_offset(built.surface_get_format(0), _count, Mesh.ARRAY_NORMAL)
	_stride = RenderingServer.mesh_surface_get_format_normal_tangent_stride(built.surface_get_format(0), _count)
	mesh = built
	attribution = _session.attribution(asset)
	return true
