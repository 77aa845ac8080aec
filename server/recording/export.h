// `crumple export FILE -o FOLDER`: a recording for the eyes of other programs. Out, into the folder:
//   {car}.glb          each car as a film: its shapes as morph targets, its way through the world; time 0 is its first frame
//   {car}_{tick}.obj   its surface in its own frame, as it appears and whenever it has changed
//   reactions.csv      a line for each car and tick that was touched
// A car that comes back from another asset is {car}-2, and so on.
#pragma once

#include <string>

namespace crumple {

struct ExportOptions {
  std::string file, folder;
  double fps = 30;  // frames a second of the recording; a crash lasts four ticks
};

// Returns the exit code. Throws std::runtime_error with one sentence: file, fact, remedy.
int export_recording(const ExportOptions&);

}  // namespace crumple
