// The program's own host and viewer use the client library, as a game does. `crumple drive` and `crumple watch` run this.
#include <CLI/CLI.hpp>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <exception>

#include "cpp/drive.h"
#include "cpp/options.h"
#include "cpp/watch.h"

namespace {

using namespace crumple::client;

std::atomic<bool> stop{false};
static_assert(std::atomic<bool>::is_always_lock_free, "set in a signal handler");

// A second Ctrl-C ends the program at once, in case the first one waits for a disk or a network that hangs.
void on_signal(int signal) {
  stop = true;
  std::signal(signal, SIG_DFL);
}

CLI::App& add_drive(CLI::App& app, DriveOptions& options) {
  CLI::App& verb =
      *app.add_subcommand("drive", "Scripted hosts: drive cars into obstacles and each other, and report the damage");
  verb.add_option("SCENE", options.file, "scene file; see clients/scenes and schema/scene.fbs")->required();
  verb.add_option("--car", options.car, "baked car (file or hash), one of the server's; it overrides the scene file's")
      ->type_name("CAR");
  verb.add_option("--connect", options.connect, "endpoint of the server")->capture_default_str();
  add_network(verb, options.network);
  verb.add_option("--scene", options.scene, "name of the server's scene")->check(scene)->capture_default_str();
  verb.add_option("--host", options.host, "id of the host of all cars for which the scene file names no host")
      ->check(id)
      ->capture_default_str();
  verb.add_option("--id", options.id, "id of the car if the scene file gives it none; default: car")->check(id);
  verb.add_option("--preset", options.preset, "file of parameters, which override the scene's; see clients/presets")
      ->type_name("FILE");
  verb.add_option("--rate", options.rate, "poses a second; default: the scene's")->check(CLI::Range(1.0, 1000.0));
  verb.add_flag("--leave", options.leave, "leaves the cars in the scene at the end");
  verb.footer("Example: crumple drive clients/scenes/pole.json --car m130.car");
  return verb;
}

CLI::App& add_watch(CLI::App& app, WatchOptions& options) {
  CLI::App& verb = *app.add_subcommand("watch", "A viewer: prints the state of each car's surface once a second");
  verb.add_option("--connect", options.connect, "endpoint of the server")->capture_default_str();
  add_network(verb, options.network);
  verb.add_option("--scene", options.scene, "name of the server's scene")->check(scene)->capture_default_str();
  verb.add_option("--car", options.car, "id of the one car to watch; default: all")->check(id);
  verb.add_option("--level", options.level, "surface level. 0: near; 1: far, which is coarser and comes ten times a second")
      ->check(CLI::Range(0, 1))
      ->capture_default_str();
  verb.add_flag("--once", options.once, "ends as soon as it has a surface; fails if none comes within 10 s");
  verb.add_option("--seconds", options.seconds, "seconds until it ends; 0: it ends by Ctrl-C")->check(CLI::NonNegativeNumber);
  verb.add_option("--obj", options.obj, "writes the last surface to this file at the end")->type_name("FILE.obj");
  verb.footer("Example: crumple watch --seconds 10 --obj dented.obj");
  return verb;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Clients of a crumple server: a host and a viewer.", "crumple"};
  app.require_subcommand(1);
  DriveOptions drive_options;
  WatchOptions watch_options;
  CLI::App& drive_verb = add_drive(app, drive_options);
  add_watch(app, watch_options);
  const char* name = argc > 1 ? argv[1] : "";
  try {
    app.parse(argc, argv);
    std::signal(SIGINT, on_signal);
    std::signal(SIGTERM, on_signal);
    // So a write beyond this process's limit of file size fails with a sentence and does not kill the process.
    std::signal(SIGXFSZ, SIG_IGN);
    return drive_verb.parsed() ? drive(drive_options, stop) : watch(watch_options, stop);
  } catch (const CLI::Success& asked) {  // --help
    return app.exit(asked);
  } catch (const CLI::ParseError& error) {
    std::fprintf(stderr, "crumple %s: %s\nTry: crumple %s --help\n", name, error.what(), name);
    return 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple %s: %s\n", name, error.what());
    return 1;
  }
}
