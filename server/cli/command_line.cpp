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
          std::string("zenoh's own configuration, laid over ours: TLS, users, who may do what; see ") + example)
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
  verb.add_option_function<std::string>("--config", read, "takes options from this file, except those given here as well")
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
          "OBJ, glTF, GLB, STL, PLY, ...; or a baked car, to paint it anew: its tets and skin stay; or built-in: the car "
          "that this program makes itself")
      ->required();
  verb.add_option("-o,--output", options.output, "the baked car to write")->required()->type_name("CAR");
  verb.add_option(
          "--pictures", options.pictures,
          "also draws the car into this folder, as CAR.png: its surface, its front, what is solid, hollow and anchored; the "
          "same as `crumple render CAR -o FOLDER`")
      ->type_name("FOLDER");
  verb.add_option("--nodes", options.nodes,
                  "wanted number of nodes, met within 5 % by the lattice and 15 % by fTetWild; several, as in 1000,5000: "
                  "levels of the car, in CAR-1000.car ...; "
                  "default: 2500")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(CLI::Range(100, 200'000));
  verb.add_option("--mesher", options.mesher,
                  "what makes the tets. lattice: for any surface, open, in many parts or with faces turned; it fills the car, "
                  "keeps every part, takes seconds, and gives the same file each time. ftetwild: for a closed surface in one "
                  "part, which its tets follow more closely; of an open one it may take minutes, drop parts, or leave the car "
                  "hollow. Default: ftetwild for a closed surface in one part, else lattice")
      ->check(CLI::IsMember({"lattice", "ftetwild"}));
  verb.add_option("--tets", bake.tets, "tets made elsewhere, in the surface's coordinates: .msh, .mesh, .node")->check(is_file);
  verb.add_option("--regions", options.regions, "file that paints regions and anchors, in the form of schema/regions.fbs")
      ->check(is_file);
  verb.add_option("--parts", options.parts,
                  "file that says what glass, lights, wheels and interior are, in the form of schema/parts.fbs; default: the "
                  "bake goes by names, materials and shape")
      ->check(is_file);
  verb.add_option("--write-parts", options.write_parts, "writes the parts to a file that --parts takes, to correct them")
      ->type_name("FILE");
  verb.add_option("--mass", bake.mass, "kg; default: a baked car's own, else 1500")->check(CLI::Range(1.0, 100'000.0));
  const CLI::IsMember axes({"x", "y", "z", "-x", "-y", "-z"});
  verb.add_option("--forward", bake.import.forward, "the input's axis that points forward; default: as its format says")
      ->check(axes);
  verb.add_option("--up", bake.import.up, "the input's axis that points up; default: as its format says")->check(axes);
  verb.add_option("--scale", bake.import.scale, "metres in one unit of the input")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  verb.add_option("--name", bake.name, "default: a baked car's own, else the input's file name");
  verb.add_option("--attribution", bake.attribution, "whom to credit, as it must be shown");
  verb.footer(
      "Examples: crumple bake vehicle.gltf -o m130.car --forward -z --up y --attribution '\"130\" by mononofu, CC-BY-4.0'\n"
      "          crumple bake m130.car --regions painted.json -o painted.car\n"
      "          crumple bake vehicle.glb -o car.car --pictures pictures");
  return [&options] { return bake_command(options); };
}

Verb add_serve(CLI::App& app, ServeOptions& options) {
  CLI::App& verb = *app.add_subcommand("serve", "Runs a scene: hosts move cars in it, viewers receive their dents");
  verb.add_option("--car", options.cars, "baked cars that may be spawned; those of the same surface are levels of one car")
      ->required()
      ->check(is_file)
      ->type_name("CAR");
  verb.add_option("--scene", options.scene, "name of the scene in all keys")->check(scene)->capture_default_str();
  verb.add_option("--listen", options.listen,
                  "endpoint; port 0: any free one. 127.0.0.1 is reached from this machine only; tcp/0.0.0.0:7447 from the "
                  "network, by anyone unless --network says who")
      ->capture_default_str();
  verb.add_option(
          "--connect", options.connect,
          "instead of listening: endpoints of zenoh routers, comma separated; hosts and viewers connect to them as well")
      ->type_name("ENDPOINTS");
  verb.add_flag("--standby", options.standby,
                "holds the world of the scene's server, tick by tick, and goes on in its place when it is gone");
  add_network(verb, options.network, "server/network.json5");
  verb.add_option("--rate", options.rate, "ticks a second")->check(CLI::Range(1.0, 1000.0))->capture_default_str();
  verb.add_option("--threads", options.threads, "for the tick; 0: all cores. No influence on the outcome")
      ->check(CLI::Range(0, 256))
      ->capture_default_str();
  verb.add_option("--budget", options.budget_ms,
                  "milliseconds of a tick: beyond them cars are solved less accurately, those that matter least first; "
                  "0: no limit")
      ->check(CLI::NonNegativeNumber)
      ->type_name("MS")
      ->capture_default_str();
  verb.add_option("--quantum", options.quantum_mm, "of the surface that viewers get, mm")
      ->check(CLI::Range(0.001, 100.0))
      ->capture_default_str();
  verb.add_option("--record", options.record,
                  "records the run in this file; %F-%H%M%S and the like: the time of its start (UTC), as in strftime, so that "
                  "a service that starts again keeps what it recorded before")
      ->type_name("FILE.mcap");
  verb.add_option(
          "--record-minutes", options.record_minutes,
          "goes on in another --record file after so long, which begins with the whole world and replays by itself: named by "
          "its time, or with -2, -3, ...; 0: only when the index of one has grown to 32 MiB, or its keys to 32,768")
      ->check(CLI::Range(0.0, 60.0 * 24 * 365))
      ->capture_default_str();
  verb.add_option("--record-most", options.record_most,
                  "gigabytes of all --record files of this run: a quarter of it fills a file, and the oldest are removed; "
                  "0: all are kept")
      ->check(CLI::Range(0.0, 1e6))
      ->type_name("GB")
      ->capture_default_str();
  verb.add_option("--metrics", options.metrics, "shows what health says to Prometheus, at http://HOST:PORT/metrics")
      ->type_name("HOST:PORT");
  verb.add_option("--seconds", options.seconds, "ends by itself after so long; 0: by Ctrl-C or SIGTERM")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  verb.add_flag("--check-config", options.check, "says whether options, cars and network configuration are good; opens nothing")
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
                  "endpoint; port 0: any free one. 127.0.0.1 is reached from this machine only; tcp/0.0.0.0:7447 from the "
                  "network, by anyone unless --network says who")
      ->capture_default_str();
  verb.add_option("--connect", options.connect, "endpoints of other routers, comma separated")->type_name("ENDPOINTS");
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
                      "a recording, played again and again; two: beside each other, their difference as colours; "
                      "default: a server's scene")
          ->check(is_file)
          ->expected(0, 2)
          ->type_name("FILE.mcap");
  CLI::Option* speed = verb.add_option("--speed", options.speed, "of the recording: 1 is as it was")
                           ->needs(file)
                           ->check(CLI::Range(0.01, 100.0))
                           ->capture_default_str();
  verb.add_option("--connect", options.connect, "endpoint of the server")->excludes(file)->capture_default_str();
  add_network(verb, options.network, "clients/network.json5");
  verb.add_option("--scene", options.scene, "name of the server's scene")->check(scene)->excludes(file)->capture_default_str();
  verb.add_option("--listen", options.listen,
                  "of the page; port 0: any free one. 127.0.0.1 is reached from this machine only; 0.0.0.0:8080 also from a "
                  "phone in the same network, and from whoever else is in it")
      ->type_name("HOST:PORT")
      ->capture_default_str();
  verb.add_flag("--control", options.control,
                "lets browsers command the scene too: tune, repair, paint and replace any car; without it they only look")
      ->excludes(file);
  verb.add_option("--page", options.page, "the page; default: web/index.html beside the program")->type_name("FILE.html");
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
  CLI::Option* verify =
      verb.add_flag("--verify", options.verify,
                    "feeds the inputs to a fresh world; fails at the first tick that differs in its hash or in what it gave");
  CLI::Option* publish = verb.add_flag("--publish", options.publish, "sends the outputs to viewers");
  verb.add_option("--threads", options.threads, "of --verify; 0: all cores")->check(CLI::Range(0, 256))->capture_default_str();
  verb.add_option("--listen", options.listen, "of --publish: endpoint")->needs(publish)->capture_default_str();
  add_network(verb, options.network, "server/network.json5");
  verb.add_option("--speed", options.speed, "of --publish: 1 is as it was")
      ->needs(publish)
      ->check(CLI::Range(0.01, 100.0))
      ->capture_default_str();
  verb.add_option("--from", options.from, "of --publish: seconds to skip")->needs(publish)->check(CLI::NonNegativeNumber);
  verb.add_flag("--loop", options.loop, "of --publish: again and again, until Ctrl-C")->needs(publish);
  verb.footer(
      "Examples: crumple replay recordings/*.mcap --verify\n          crumple replay today.mcap --publish --speed 0.1 --loop");
  verb.callback([verify, publish] {
    if (verify->empty() && publish->empty()) throw CLI::RequiredError("--verify or --publish");
  });
  return [&options] { return replay(options, stop); };
}

Verb add_info(CLI::App& app, std::vector<std::string>& files) {
  CLI::App& verb = *app.add_subcommand("info", "Says what is in a recording or a baked car");
  verb.add_option("FILE", files, "recordings, baked cars")->required()->check(is_file);
  verb.footer("Example: crumple info recordings/built_in_pole.mcap");
  return [&files] { return info(files); };
}

struct MapOptions {
  std::string car, mesh;
};

Verb add_map(CLI::App& app, MapOptions& options) {
  CLI::App& verb = *app.add_subcommand("map", "Says how well a mesh of a game fits a baked car whose dents it is to show");
  verb.add_option("CAR", options.car, "baked car")->required()->check(is_file);
  verb.add_option("MESH", options.mesh, "mesh file, in the coordinates of the file from which the car was baked")
      ->required()
      ->check(is_file);
  verb.footer(
      "A game maps its own vertices itself, with crumple_map of the client library. This verb shows beforehand whether another "
      "level "
      "of detail, or a mesh that was changed after the bake, will follow the dents.\n"
      "Example: crumple map car.car car_lod1.glb");
  return [&options] { return map_mesh(options.car, options.mesh); };
}

Verb add_fit(CLI::App& app, FitCommandOptions& options) {
  CLI::App& verb = *app.add_subcommand("fit", "Finds a car's material from published crash tests, and writes it as a preset");
  verb.add_option("CAR", options.cars, "baked car; with several levels the coarsest is fitted, the others check it")
      ->required()
      ->check(is_file);
  verb.add_option("--tests", options.tests, "the tests; see below")->required()->check(is_file)->type_name("TESTS.csv");
  verb.add_option("-o,--output", options.output, "the preset to write, for `crumple drive --preset`")
      ->required()
      ->type_name("PRESET.json");
  verb.add_flag("--scale", options.scale, "fits only the scale of all stresses, whatever the tests are");
  verb.add_option("--about", options.about, "what the preset says of itself; default: the tests' names");
  verb.add_option("--picture", options.picture, "also draws published crush and force beside ours")->type_name("FILE.png");
  verb.footer(
      "TESTS.csv is a table of crashes into a rigid wall, one hit a row. The first row names its columns. Lines that begin "
      "with "
      "# are comments. This one is of a car that was hit three times (NHTSA tests 1201 to 1203, Ford Taurus 1986):\n\n"
      "  test,car,mass_kg,width_mm,speed_kmh,damage_mm,c1_mm,c2_mm,c3_mm,c4_mm,c5_mm,c6_mm\n"
      "  1201,taurus,1591,1768,15.5,1664,25,51,76,79,71,48\n"
      "  1202,taurus,1591,1768,31.9,1664,170,201,221,224,213,173\n"
      "  1203,taurus,1591,1768,32.3,1664,320,353,373,376,366,333\n\n"
      "The car is scaled to length and width of each test. Columns (empty cells are allowed unless it says always):\n\n" +
      explain_columns() +
      "\nOne test, or only A and B, gives one constant: the scale of all stresses. A pulse, or three hits of one car, gives "
      "all "
      "constants. It takes seconds: some ten runs for each constant. NHTSA's vehicle crash test database has such tests of "
      "thousands of cars.\n"
      "Example: crumple fit car-1000.car car-5000.car --tests clients/presets/classes/mid_size.csv -o mine.json --picture "
      "mine.png");
  return [&options] { return fit_command(options); };
}

Verb add_recover(CLI::App& app, RecoverOptions& options) {
  CLI::App& verb =
      *app.add_subcommand("recover", "Makes a whole recording of one that was cut off or damaged, up to its last tick");
  verb.add_option("FILE", options.input, "the recording; it is only read")->required()->check(is_file);
  verb.add_option("-o,--output", options.output, "the whole recording to write")->required()->type_name("FILE.mcap");
  verb.footer(
      "After a kill, a crash or a power cut. crumple reads a cut recording as it is; other MCAP tools need the index at the "
      "end.\n"
      "Example: crumple recover killed.mcap -o whole.mcap");
  return [&options] { return recover(options); };
}

Verb add_export(CLI::App& app, ExportOptions& options, std::string& model) {
  CLI::App& verb =
      *app.add_subcommand("export", "Writes a recording for other programs: glTF films, OBJ surfaces, a table of reactions");
  verb.add_option("FILE", options.file, "recording")->required()->check(is_file);
  verb.add_option("-o,--output", options.folder,
                  "for CAR.glb (morph targets and motion), CAR_TICK.obj (where it changed, in the car's frame), reactions.csv")
      ->required()
      ->type_name("FOLDER");
  verb.add_option("--fps", options.fps, "frames a second of the recording; those in which nothing changed are left out")
      ->check(CLI::Range(0.1, 1000.0))
      ->capture_default_str();
  verb.add_option("--mesh", model,
                  "the glTF file from which the cars were baked: CAR.glb then has its vertices, materials and textures")
      ->check(is_file)
      ->type_name("MODEL.glb");
  verb.footer("Example: crumple export today.mcap -o today");
  return [&options, &model] {
    const int status = export_recording(options);
    return status == 0 && !model.empty() ? export_model(options, model) : status;
  };
}

Verb add_render(CLI::App& app) {
  CLI::App& verb =
      *app.add_subcommand("render", "Draws a recording: slow motion, a contact sheet, charts; or a baked car: what is solid");
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
      "then: crumple replay today.mcap --verify\n"
      "Each verb explains itself: crumple VERB --help");
  const std::vector<Verb> verbs = {
      add_bake(app, bake_options),
      add_serve(app, serve_options),
      add_router(app, router_options),
      add_client(app, "drive", "A scripted host: drives a car into things and says what became of it"),
      add_client(app, "watch", "A viewer: prints once a second what it holds of each car"),
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
