// The options that both clients of the program have.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "io/files.h"
#include "io/net.h"
#include "protocol/key.h"

namespace crumple::client {

inline const CLI::Validator scene(
    [](std::string& text) -> std::string {
      if (crumple::is_scene(text)) return "";
      return crumple::is_id(text)
                 ? "\"" + text + "\" cannot name a scene, because the keys of baked cars begin with it; give another name"
                 : "\"" + text + "\" is not an id: use " + id_rule;
    },
    "ID");
inline const CLI::Validator id(
    [](std::string& text) -> std::string {
      return crumple::is_id(text) ? "" : "\"" + text + "\" is not an id: use " + id_rule;
    },
    "ID");

// text: gets the content of the file.
inline void add_network(CLI::App& verb, std::string& text) {
  const auto read = [&text](const std::string& path) {
    try {
      text = read_file(path, text_limit, "check the path, and that this user may read it");
    } catch (const std::runtime_error& refused) {
      throw CLI::FileError(refused.what());
    }
    if (net_check(text.c_str()) != 0) throw CLI::FileError(path + ": " + transport_error());
  };
  verb.add_option_function<std::string>(
          "--network", read, "Zenoh configuration that overrides ours: TLS, a user, certificates; see clients/network.json5")
      ->type_name("FILE.json5");
}

}  // namespace crumple::client
