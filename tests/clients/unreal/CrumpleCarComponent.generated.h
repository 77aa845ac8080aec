// Unreal generates a file with this name.
