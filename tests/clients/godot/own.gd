# A model of the game that has the shape of the baked car: two surfaces, all vertices split and in another order, UVs, colours,
# tangents, levels of detail, in centimetres and axes of its own. The second surface is compressed.
extends Node3D

var given := ArrayMesh.new()
var body := MeshInstance3D.new()
var baked: Array[PackedInt32Array] = [[], []]  # for each vertex of each surface the vertex of the baked car
var to_car: Transform3D


# car: draws the undamaged baked car.
func _init(car: MeshInstance3D) -> void:
	transform = Transform3D(Basis.from_euler(Vector3(0.3, -0.7, 0.1)), Vector3(0.2, 0.1, -0.3))
	body.name = "Body"
	body.scale = Vector3.ONE * 0.01
	body.position = Vector3(0, 0.5, 0)
	add_child(body)
	to_car = car.transform.affine_inverse() * transform * body.transform
	var arrays: Array = car.arrays()
	for i in 2:
		add(i, arrays[Mesh.ARRAY_VERTEX], arrays[Mesh.ARRAY_NORMAL], arrays[Mesh.ARRAY_INDEX])
	body.mesh = given
	body.set_surface_override_material(1, StandardMaterial3D.new())


func add(surface: int, at: PackedVector3Array, normals: PackedVector3Array, corners: PackedInt32Array) -> void:
	var order := []
	for i in range(surface, corners.size() / 3, 2):
		order.append_array([3 * i, 3 * i + 1, 3 * i + 2])
	var rank := order.duplicate()  # of the corner of the baked car that own vertex i is
	seed(7)
	rank.shuffle()
	var vertex_of := {}
	var arrays := []
	arrays.resize(Mesh.ARRAY_MAX)
	for kind: int in [Mesh.ARRAY_VERTEX, Mesh.ARRAY_NORMAL]:
		arrays[kind] = PackedVector3Array()
	arrays[Mesh.ARRAY_TANGENT] = PackedFloat32Array()
	arrays[Mesh.ARRAY_TEX_UV] = PackedVector2Array()
	arrays[Mesh.ARRAY_COLOR] = PackedColorArray()
	for i in rank.size():
		var corner: int = rank[i]
		var b := corners[corner]
		vertex_of[corner] = i
		baked[surface].append(b)
		arrays[Mesh.ARRAY_VERTEX].append(to_car.affine_inverse() * at[b])
		var normal := (to_car.basis.inverse() * normals[b]).normalized()
		var tangent := normal.cross(Vector3(0.3, 0.5, 0.8)).normalized()
		arrays[Mesh.ARRAY_NORMAL].append(normal)
		arrays[Mesh.ARRAY_TANGENT].append_array([tangent.x, tangent.y, tangent.z, 1.0 if i % 3 else -1.0])
		arrays[Mesh.ARRAY_TEX_UV].append(Vector2(0.001 * i, 0.25))
		arrays[Mesh.ARRAY_COLOR].append(Color8(i % 256, 20, 30, 40))
	arrays[Mesh.ARRAY_INDEX] = PackedInt32Array(order.map(func(corner: int) -> int: return vertex_of[corner]))
	var lods := {0.5: arrays[Mesh.ARRAY_INDEX].slice(0, 300)}
	given.add_surface_from_arrays(Mesh.PRIMITIVE_TRIANGLES, arrays, [], lods, Mesh.ARRAY_FLAG_COMPRESS_ATTRIBUTES if surface else 0)
	given.surface_set_material(surface, StandardMaterial3D.new())
