# main.tscn shows one car from the side until the car is gone. The arguments after "--" name the server and the car.
#   godot --path clients/godot -- tcp/127.0.0.1:7447 car1
extends Node3D


func _enter_tree() -> void:
	var arguments := OS.get_cmdline_user_args()
	if arguments.size() == 2:
		$Pose/Car.endpoint = arguments[0]
		$Pose/Car.car = arguments[1]
	$Pose/Car.drawn.connect(_on_drawn)
	$Pose/Car.gone.connect(get_tree().quit)


func _on_drawn() -> void:
	$Attribution.text = $Pose/Car.attribution
	print("%s: %d vertices\n%s" % [$Pose/Car.car, $Pose/Car.mesh.surface_get_array_len(0), $Attribution.text])
