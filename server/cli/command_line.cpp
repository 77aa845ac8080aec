#include "cli/command_line.h"

#include <CLI/CLI.hpp>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <sstream>

#include "cli/bake_command.h"
#include "cli/fit_command.h"
#include "cli/info.h"
#include "cli/map.h"
#include "cli/render.h"
#include "cli/router.h"
#include "cli/run_client.h"
#include "fit/test_file.h"
#include "gateway/view.h"
#include "io/files.h"
#include "io/net.h"
#include "protocol/key.h"
#include "recording/export.h"
#include "recording/recording.h"
#include "recording/recover.h"
#include "recording/replay.h"
#include "service/serve.h"

namespace crumple {
namespace {

std::atomic<bool> stop{false};
static_assert(std::atomic<bool>::is_always_lock_free, "set in a signal handler");

// A second Ctrl-C ends the program at once, in case the first one waits for a disk or a network that is stuck.
void on_signal(int signal) {
  stop = true;
  std::signal(signal, SIG_DFL);
}

const CLI::Validator id(
    [](std::string& text) -> std::string { return is_id(text) ? "" : "\"" + text + "\" is not an id: use " + id_rule; }, "ID");

const CLI::Validator scene(
    [](std::string& text) -> std::string {
      if (is_scene(text)) return "";
      return is_id(text)
                 ? "\"" + text + "\" cannot name a scene, because the keys of baked cars begin with it; give another name"
                 : "\"" + text + "\" is not an id: use " + id_rule;
    },
    "ID");

// Refuses pipes, because they may never end, and opening one waits until somebody writes.
const CLI::Validator is_file(
    [](std::string& path) -> std::string {
      std::error_code none;
      if (std::filesystem::is_regular_file(path, none)) return "";
      return path + (std::filesystem::exists(path, none) ? ": is a folder, a pipe or a device; name a file"
                                                         : ": there is no such file; check the path");
    },
    "FILE");

// Reads the text file that an option names.
std::string read_text(const std::string& path) {
  try {
    return read_file(path, text_limit, "check the path, and that this user may read it");
  } catch (const std::runtime_error& refused) {
    throw CLI::FileError(refused.what());
  }
}

// Adds --network, for every verb with a network. text: receives the file's content.
void add_network(CLI::App& verb, std::string& text, const char* example) {
  const auto read = [&text](const std::string& path) {
    if (path.empty()) return;
    text = read_text(path);
    if (net_check(text.c_str()) != 0) throw CLI::FileError(path + ": " + transport_error());
  };
  verb.add_option_function<std::string>(
          "--network", read,
          std::string("Zenoh configuration that overrides ours: TLS, users and their rights; see ") + example)
      ->type_name("FILE.json5")
      ->run_callback_for_default();  // the default is empty: this is only so that --print-config shows the option
}

// Adds --config: options from a file in the form of --print-config. The command line overrides them. Add it last: options are
// read in the order in which they were added, so an error at this point is the file's.
void add_config(CLI::App& verb) {
  const auto read = [&verb](const std::string& path) {
    std::istringstream text(read_text(path));
    try {
      verb.parse_from_stream(text);
    } catch (const CLI::Success&) {
      throw;
    } catch (const CLI::ParseError& error) {
      throw CLI::FileError(path + ": " + error.what() + "; `crumple " + verb.get_name() +
                           " --car CAR --print-config` shows every key and what it means");
    }
  };
  verb.allow_config_extras(CLI::config_extras_mode::error);
  verb.add_option_function<std::string>("--config", read,
                                        "reads options from this file; options on the command line override them")
      ->type_name("FILE.toml")
      ->configurable(false);
}

using Verb = std::function<int()>;

// Each of these functions adds one verb and returns its action.
Verb add_bake(CLI::App& app, BakeCommandOptions& options) {
  CLI::App& verb =
      *app.add_subcommand("bake", "Turns a surface mesh into a baked car: tetrahedra, constraints, skin, one file");
  BakeOptions& bake = options.bake;
  verb.add_option(
          "INPUT", bake.input,
          "surface file (OBJ, glTF, GLB, STL, PLY, ...); or a baked car, to paint it anew: it keeps its tets and skin; or the "
          "word built-in: the car that this program makes itself")
      ->required();
  verb.add_option("-o,--output", options.output, "the baked car to write")->required()->type_name("CAR");
  verb.add_option(
          "--pictures", options.pictures,
          "also draws the car into this folder, as CAR.png: its surface, its front, and cuts that show what is solid, hollow "
          "and anchored; `crumple render CAR -o FOLDER` draws the same")
      ->type_name("FOLDER");
  verb.add_option("--nodes", options.nodes,
                  "number of nodes; the lattice meets it within 5 %, fTetWild within 15 %. Several numbers, such as "
                  "1000,5000, make several levels of the car: CAR-1000.car, CAR-5000.car. Default: 2500")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(CLI::Range(100, 200'000));
  verb.add_option("--mesher", options.mesher,
                  "method that makes the tets. lattice: for any surface, also one that is open, in many pieces, or has "
                  "faces that point inwards; it fills the car, keeps every piece, takes seconds, and gives the same file each "
                  "time. ftetwild: for a closed surface of one piece; its tets follow the surface more closely, but with an "
                  "open surface it may take minutes, drop pieces, or leave the car hollow. Default: ftetwild for a closed "
                  "surface of one piece, otherwise lattice")
      ->check(CLI::IsMember({"lattice", "ftetwild"}));
  verb.add_option("--tets", bake.tets,
                  "file with tets that another program made, in the surface's coordinates: .msh, .mesh, .node")
      ->check(is_file);
  verb.add_option("--regions", options.regions, "file that paints regions and anchors, in the form of schema/regions.fbs")
      ->check(is_file);
  verb.add_option("--parts", options.parts,
                  "file that lists the glass, lights, wheels and other parts, in the form of schema/parts.fbs; default: the "
                  "bake finds them by names, materials and shape")
      ->check(is_file);
  verb.add_option("--write-parts", options.write_parts, "writes the parts to this file; correct it and give it to --parts")
      ->type_name("FILE");
  verb.add_option("--mass", bake.mass, "mass of the car, kg; default: 1500, but a baked car as input keeps its mass")
      ->check(CLI::Range(1.0, 100'000.0));
  const CLI::IsMember axes({"x", "y", "z", "-x", "-y", "-z"});
  verb.add_option("--forward", bake.import.forward, "the input's axis that points forward; default: the axis of its format")
      ->check(axes);
  verb.add_option("--up", bake.import.up, "the input's axis that points up; default: the axis of its format")->check(axes);
  verb.add_option("--scale", bake.import.scale, "metres in one unit of the input")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  verb.add_option("--name", bake.name,
                  "name of the car; default: the input's file name, but a baked car as input keeps its name");
  verb.add_option("--attribution", bake.attribution,
                  "text that credits the author of the surface; every program that shows the car must show it");
  verb.footer(
      "Examples: crumple bake vehicle.gltf -o m130.car --forward -z --up y --attribution '\"130\" by mononofu, CC-BY-4.0'\n"
      "          crumple bake m130.car --regions painted.json -o painted.car\n"
      "          crumple bake vehicle.glb -o car.car --pictures pictures");
  return [&options] { return bake_command(options); };
}

Verb add_serve(CLI::App& app, ServeOptions& options) {
  CLI::App& verb = *app.add_subcommand("serve", "Runs a scene: hosts move cars in it, viewers receive their dents");
  verb.add_option("--car", options.cars, "baked cars that hosts may spawn; cars with the same surface are levels of one car")
      ->required()
      ->check(is_file)
      ->type_name("CAR");
  verb.add_option("--scene", options.scene, "name of the scene in all keys")->check(scene)->capture_default_str();
  verb.add_option("--listen", options.listen,
                  "endpoint; port 0: any free port. Only this machine reaches 127.0.0.1; every program in the network reaches "
                  "tcp/0.0.0.0:7447, unless --network restricts it")
      ->capture_default_str();
  verb.add_option(
          "--connect", options.connect,
          "instead of --listen: endpoints of Zenoh routers, separated by commas; hosts and viewers connect to the same routers")
      ->type_name("ENDPOINTS");
  verb.add_flag("--standby", options.standby,
                "computes the same ticks as the scene's server, and takes over when that server is gone");
  add_network(verb, options.network, "server/network.json5");
  verb.add_option("--rate", options.rate, "ticks a second")->check(CLI::Range(1.0, 1000.0))->capture_default_str();
  verb.add_option("--threads", options.threads,
                  "threads that compute the tick; 0: one per core. The result does not depend on it")
      ->check(CLI::Range(0, 256))
      ->capture_default_str();
  verb.add_option("--budget", options.budget_ms,
                  "time for the cars of one tick, ms; if it does not suffice, the server computes cars less accurately, the "
                  "least important ones first; 0: no limit")
      ->check(CLI::NonNegativeNumber)
      ->type_name("MS")
      ->capture_default_str();
  verb.add_option("--quantum", options.quantum_mm, "unit of the displacements that viewers receive, mm")
      ->check(CLI::Range(0.001, 100.0))
      ->capture_default_str();
  verb.add_option("--record", options.record,
                  "records the run in this file. %F-%H%M%S in the name, or other codes of strftime, becomes the time of the "
                  "start (UTC), so a service that restarts keeps its earlier recordings")
      ->type_name("FILE.mcap");
  verb.add_option(
          "--record-minutes", options.record_minutes,
          "minutes until the next --record file begins. Each file begins with the whole world and can be replayed alone; its "
          "name has its own time, or -2, -3, ... 0: the next file begins only when the index has 32 MiB or 32,768 keys")
      ->check(CLI::Range(0.0, 60.0 * 24 * 365))
      ->capture_default_str();
  verb.add_option("--record-most", options.record_most,
                  "most gigabytes of all --record files of this run: the server removes the oldest files, and begins the next "
                  "file at a quarter of this size; 0: it keeps all files")
      ->check(CLI::Range(0.0, 1e6))
      ->type_name("GB")
      ->capture_default_str();
  verb.add_option("--metrics", options.metrics, "serves the values of health to Prometheus, at http://HOST:PORT/metrics")
      ->type_name("HOST:PORT");
  verb.add_option("--seconds", options.seconds, "seconds until the server ends; 0: it ends by Ctrl-C or SIGTERM")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  verb.add_flag("--check-config", options.check, "checks the options, cars and network configuration, and ends; opens nothing")
      ->configurable(false);
  const CLI::Option* print = verb.add_flag("--print-config")
                                 ->description("prints all options as a file for --config, with comments")
                                 ->configurable(false);
  add_config(verb);
  verb.footer(
      "Example: crumple serve --car m130.car --record today.mcap\n"
      "A service: crumple serve --car m130.car --print-config > server.toml\n"
      "           crumple serve --config server.toml");
  return [&options, &verb, print] {
    if (print->count() == 0) return serve(options, stop);
    std::fputs(verb.config_to_str(true, true).c_str(), stdout);
    return 0;
  };
}

Verb add_router(CLI::App& app, RouterOptions& options) {
  CLI::App& verb =
      *app.add_subcommand("router", "Connects servers, hosts and viewers: several scenes, standbys, several sites");
  verb.add_option("--listen", options.listen,
                  "endpoint; port 0: any free port. Only this machine reaches 127.0.0.1; every program in the network reaches "
                  "tcp/0.0.0.0:7447, unless --network restricts it")
      ->capture_default_str();
  verb.add_option("--connect", options.connect, "endpoints of other routers, separated by commas")->type_name("ENDPOINTS");
  add_network(verb, options.network, "server/router.json5");
  verb.footer(
      "Example: crumple router --listen tls/0.0.0.0:7447 --network router.json5\n"
      "         crumple serve --car m130.car --connect tls/dents.example.org:7447 --network as_server.json5");
  return [&options] { return router(options, stop); };
}

// Adds a verb of the client program beside this one, which uses only the client library.
Verb add_client(CLI::App& app, const char* name, const char* description) {
  CLI::App& verb = *app.add_subcommand(name, description);
  verb.set_help_flag();
  verb.prefix_command();
  return [&verb] { return run_client(verb.get_name(), verb.remaining()); };
}

Verb add_view(CLI::App& app, ViewOptions& options) {
  CLI::App& verb =
      *app.add_subcommand("view", "Shows a scene, or a recording, in browsers: a page with every car and its dents");
  CLI::Option* file =
      verb.add_option("FILE", options.files,
                      "a recording, which is played in a loop; or two, side by side, with their differences as colours; "
                      "default: a server's scene")
          ->check(is_file)
          ->expected(0, 2)
          ->type_name("FILE.mcap");
  CLI::Option* speed = verb.add_option("--speed", options.speed, "speed of the recording; 1: real speed")
                           ->needs(file)
                           ->check(CLI::Range(0.01, 100.0))
                           ->capture_default_str();
  verb.add_option("--connect", options.connect, "endpoint of the server")->excludes(file)->capture_default_str();
  add_network(verb, options.network, "clients/network.json5");
  verb.add_option("--scene", options.scene, "name of the server's scene")->check(scene)->excludes(file)->capture_default_str();
  verb.add_option("--listen", options.listen,
                  "address of the page; port 0: any free port. Only this machine reaches 127.0.0.1; every device in the same "
                  "network, for example a phone, reaches 0.0.0.0:8080")
      ->type_name("HOST:PORT")
      ->capture_default_str();
  verb.add_flag("--control", options.control,
                "lets browsers also change the scene: tune, repair, paint and replace any car; without it they only watch")
      ->excludes(file);
  verb.add_option("--page", options.page, "the page to serve; default: web/index.html beside the program")
      ->type_name("FILE.html");
  verb.footer(
      "Examples: crumple view\n          crumple view --control\n          crumple view today.mcap --speed 0.25\n          "
      "crumple view before.mcap after.mcap");
  verb.callback([speed, &options] {
    if (options.files.size() > 1 && !speed->empty())
      throw CLI::ValidationError("--speed", "applies to one recording only; with two, choose the speed on the page");
  });
  return [&options] { return view(options, stop); };
}

Verb add_replay(CLI::App& app, ReplayOptions& options) {
  CLI::App& verb = *app.add_subcommand("replay", "Runs recordings again and compares every tick, or plays them to viewers");
  verb.add_option("FILE", options.files, "recordings")->required()->check(is_file);
  CLI::Option* verify = verb.add_flag(
      "--verify", options.verify, "feeds the inputs to a fresh world; fails at the first tick whose hash or messages differ");
  CLI::Option* publish = verb.add_flag("--publish", options.publish, "sends the recorded outputs to viewers");
  verb.add_option("--threads", options.threads, "threads for --verify; 0: one per core")
      ->check(CLI::Range(0, 256))
      ->capture_default_str();
  verb.add_option("--listen", options.listen, "for --publish: endpoint to which viewers connect")
      ->needs(publish)
      ->capture_default_str();
  add_network(verb, options.network, "server/network.json5");
  verb.add_option("--speed", options.speed, "for --publish: speed; 1: real speed")
      ->needs(publish)
      ->check(CLI::Range(0.01, 100.0))
      ->capture_default_str();
  verb.add_option("--from", options.from, "for --publish: seconds to skip at the start")
      ->needs(publish)
      ->check(CLI::NonNegativeNumber);
  verb.add_flag("--loop", options.loop, "for --publish: plays in a loop, until Ctrl-C")->needs(publish);
  verb.footer(
      "Examples: crumple replay recordings/*.mcap --verify\n          crumple replay today.mcap --publish --speed 0.1 --loop");
  verb.callback([verify, publish] {
    if (verify->empty() && publish->empty()) throw CLI::RequiredError("--verify or --publish");
  });
  return [&options] { return replay(options, stop); };
}

Verb add_info(CLI::App& app, std::vector<std::string>& files) {
  CLI::App& verb = *app.add_subcommand("info", "Describes a recording or a baked car");
  verb.add_option("FILE", files, "recordings or baked cars")->required()->check(is_file);
  verb.footer("Example: crumple info recordings/built_in_pole.mcap");
  return [&files] { return info(files); };
}

struct MapOptions {
  std::string car, mesh;
};

Verb add_map(CLI::App& app, MapOptions& options) {
  CLI::App& verb = *app.add_subcommand("map", "Measures how well a game's own mesh fits a baked car, whose dents it will show");
  verb.add_option("CAR", options.car, "baked car")->required()->check(is_file);
  verb.add_option("MESH", options.mesh, "mesh file, in the coordinates of the file from which the car was baked")
      ->required()
      ->check(is_file);
  verb.footer(
      "A game maps its own vertices itself, with crumple_map of the client library. This verb shows beforehand whether a level "
      "of detail, or a mesh that was changed after the bake, will follow the dents.\n"
      "Example: crumple map car.car car_lod1.glb");
  return [&options] { return map_mesh(options.car, options.mesh); };
}

Verb add_fit(CLI::App& app, FitCommandOptions& options) {
  CLI::App& verb = *app.add_subcommand("fit", "Finds a car's material from published crash tests, and writes it as a preset");
  verb.add_option("CAR", options.cars, "baked car; of several levels the coarsest is fitted, and the others check the result")
      ->required()
      ->check(is_file);
  verb.add_option("--tests", options.tests, "table of crash tests; see below")
      ->required()
      ->check(is_file)
      ->type_name("TESTS.csv");
  verb.add_option("-o,--output", options.output, "the preset to write, for `crumple drive --preset`")
      ->required()
      ->type_name("PRESET.json");
  verb.add_flag("--scale", options.scale, "fits only the scale of all stresses, even if the tests would give more");
  verb.add_option("--about", options.about, "description of the preset; default: the names of the tests");
  verb.add_option("--picture", options.picture, "also draws our crush and force beside the published ones")
      ->type_name("FILE.png");
  verb.footer(
      "TESTS.csv is a table of crashes into a rigid wall, one hit in each row. The first row names its columns. Lines that "
      "begin "
      "with # are comments. In this example a car was hit three times (NHTSA tests 1201 to 1203, Ford Taurus 1986):\n\n"
      "  test,car,mass_kg,width_mm,speed_kmh,damage_mm,c1_mm,c2_mm,c3_mm,c4_mm,c5_mm,c6_mm\n"
      "  1201,taurus,1591,1768,15.5,1664,25,51,76,79,71,48\n"
      "  1202,taurus,1591,1768,31.9,1664,170,201,221,224,213,173\n"
      "  1203,taurus,1591,1768,32.3,1664,320,353,373,376,366,333\n\n"
      "The baked car is scaled to the length and width of each test. Columns (a cell may be empty, except in columns with "
      "\"always\"):\n\n" +
      explain_columns() +
      "\nOne test, or only A and B, gives one constant: the scale of all stresses. A pulse, or three hits of one car, gives "
      "all "
      "constants. A fit takes seconds: it computes each test some ten times for each constant. NHTSA's vehicle crash test "
      "database has such tests of thousands of cars.\n"
      "Example: crumple fit car-1000.car car-5000.car --tests clients/presets/classes/mid_size.csv -o mine.json --picture "
      "mine.png");
  return [&options] { return fit_command(options); };
}

Verb add_recover(CLI::App& app, RecoverOptions& options) {
  CLI::App& verb = *app.add_subcommand(
      "recover", "Makes a whole recording from one that was cut off or damaged, up to its last intact tick");
  verb.add_option("FILE", options.input, "the damaged recording, which stays as it is")->required()->check(is_file);
  verb.add_option("-o,--output", options.output, "the whole recording to write")->required()->type_name("FILE.mcap");
  verb.footer(
      "Use it after a kill, a crash or a power cut. crumple itself reads a cut recording as it is; other MCAP tools need the "
      "index at the end.\n"
      "Example: crumple recover killed.mcap -o whole.mcap");
  return [&options] { return recover(options); };
}

Verb add_export(CLI::App& app, ExportOptions& options, std::string& model) {
  CLI::App& verb =
      *app.add_subcommand("export", "Writes a recording for other programs: glTF films, OBJ surfaces, a table of reactions");
  verb.add_option("FILE", options.file, "recording")->required()->check(is_file);
  verb.add_option("-o,--output", options.folder,
                  "folder for CAR.glb (a film: morph targets and motion), CAR_TICK.obj (each changed surface, in the car's "
                  "frame), and reactions.csv")
      ->required()
      ->type_name("FOLDER");
  verb.add_option("--fps", options.fps, "frames a second of the recording; frames without a change are left out")
      ->check(CLI::Range(0.1, 1000.0))
      ->capture_default_str();
  verb.add_option("--mesh", model,
                  "the glTF file from which the cars were baked; CAR.glb then has its vertices, materials and textures")
      ->check(is_file)
      ->type_name("MODEL.glb");
  verb.footer("Example: crumple export today.mcap -o today");
  return [&options, &model] {
    const int status = export_recording(options);
    return status == 0 && !model.empty() ? export_model(options, model) : status;
  };
}

Verb add_render(CLI::App& app) {
  CLI::App& verb = *app.add_subcommand(
      "render", "Draws a recording (slow motion, a contact sheet, charts) or a baked car (cuts that show what is solid)");
  verb.set_help_flag();
  verb.prefix_command();
  return [&verb] { return render(verb.remaining()); };
}

}  // namespace

int run(int argc, const char* const* argv) {
  BakeCommandOptions bake_options;
  ServeOptions serve_options;
  RouterOptions router_options;
  ViewOptions view_options;
  ReplayOptions replay_options;
  std::vector<std::string> info_files;
  MapOptions map_options;
  FitCommandOptions fit_options;
  RecoverOptions recover_options;
  ExportOptions export_options;
  std::string export_mesh;

  CLI::App app{"Dents in car bodies, computed on one server and shared over the network.", "crumple"};
  app.require_subcommand(1);
  app.set_version_flag("--version", program_name);
  app.footer(
      "A run, each line in its own terminal:\n"
      "  crumple bake built-in -o car.car\n"
      "  crumple serve --car car.car --record today.mcap\n"
      "  crumple view\n"
      "  crumple drive clients/scenes/pole.json --car car.car\n"
      "Then: crumple replay today.mcap --verify\n"
      "crumple VERB --help explains each verb.");
  const std::vector<Verb> verbs = {
      add_bake(app, bake_options),
      add_serve(app, serve_options),
      add_router(app, router_options),
      add_client(app, "drive", "Scripted hosts: drive cars into obstacles and each other, and report the damage"),
      add_client(app, "watch", "A viewer: prints the state of each car's surface once a second"),
      add_view(app, view_options),
      add_replay(app, replay_options),
      add_info(app, info_files),
      add_map(app, map_options),
      add_fit(app, fit_options),
      add_recover(app, recover_options),
      add_export(app, export_options, export_mesh),
      add_render(app)};
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& asked) {  // --help, --version
    return app.exit(asked);
  } catch (const CLI::ParseError& error) {
    const auto chosen = app.get_subcommands();
    const std::string verb = chosen.empty() ? "" : " " + chosen.front()->get_name();
    std::fprintf(stderr, "crumple%s: %s\nTry: crumple%s --help\n", verb.c_str(), error.what(), verb.c_str());
    return 2;
  }
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  std::signal(SIGXFSZ, SIG_IGN);  // exceeding a limit on file size must fail with a sentence, not end the program
  const auto all = app.get_subcommands({});
  for (size_t i = 0; i < verbs.size(); ++i)
    if (all[i]->parsed()) return verbs[i]();
  return 2;
}

}  // namespace crumple
