// Unreal makes one of these.
