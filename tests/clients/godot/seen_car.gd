# Stands for the graphics card: Godot without a window keeps no vertices, so this class keeps them and lets Godot decode them.
extends CrumpleCar

var vertex_data: Array[PackedByteArray] = []  # of each of _surfaces
var uploads := 0


func _build(asset: String) -> bool:
	if not super(asset):
		return false
	vertex_data.clear()
	for each in _surfaces:
		vertex_data.append(RenderingServer.mesh_get_surface(each.mesh.get_rid(), each.index).vertex_data)
	return true


func _upload(each: Surface, offset: int, bytes: PackedByteArray) -> void:
	super(each, offset, bytes)
	var data := vertex_data[_surfaces.find(each)]
	vertex_data[_surfaces.find(each)] = data.slice(0, offset) + bytes + data.slice(offset + bytes.size())
	uploads += 1


func arrays(i := 0) -> Array:
	var surface := RenderingServer.mesh_get_surface(_surfaces[i].mesh.get_rid(), _surfaces[i].index)
	assert(surface.vertex_data.size() == vertex_data[i].size())
	surface.vertex_data = vertex_data[i]
	var copy := RenderingServer.mesh_create()
	RenderingServer.mesh_add_surface(copy, surface)
	var decoded := RenderingServer.mesh_surface_get_arrays(copy, 0)
	RenderingServer.free_rid(copy)
	return decoded
