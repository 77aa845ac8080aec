// `crumple export FILE -o FOLDER`: converts a recording for other programs. It writes into the folder:
//   {car}.glb          each car as a film: its shapes as morph targets, its path through the world; time 0 is its first frame
//   {car}_{tick}.obj   its surface in its own frame, when it appears and whenever it has changed
//   reactions.csv      one line per car and tick in which something touched the car
// If a car comes back with another asset, its files are named {car}-2, and so on.
#pragma once

#include <string>

namespace crumple {

struct ExportOptions {
  std::string file, folder;
  double fps = 30;  // frames per second of the recording; a crash lasts four ticks
};

// Returns the exit code. Throws std::runtime_error with one sentence: file, fact, remedy.
int export_recording(const ExportOptions&);

}  // namespace crumple
