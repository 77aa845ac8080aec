# Stands for the graphics card: Godot without a window keeps no vertices, so this class keeps them and lets Godot decode them.
extends CrumpleCar

var vertex_data: PackedByteArray
var uploads := 0


func _build(asset: String) -> bool:
	if not super(asset):
		return false
	vertex_data = RenderingServer.mesh_get_surface(mesh.get_rid(), 0).vertex_data
	return true


func _upload(offset: int, bytes: PackedByteArray) -> void:
	super(offset, bytes)
	vertex_data = vertex_data.slice(0, offset) + bytes + vertex_data.slice(offset + bytes.size())
	uploads += 1


func arrays() -> Array:
	var surface := RenderingServer.mesh_get_surface(mesh.get_rid(), 0)
	assert(surface.vertex_data.size() == vertex_data.size())
	surface.vertex_data = vertex_data
	var copy := RenderingServer.mesh_create()
	RenderingServer.mesh_add_surface(copy, surface)
	var decoded := RenderingServer.mesh_surface_get_arrays(copy, 0)
	RenderingServer.free_rid(copy)
	return decoded
