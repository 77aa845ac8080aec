// Tests what an operator relies on: configuration, access rights, the page for Prometheus, shutdown, and that no sender can
// make ticks long.
#include <arpa/inet.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdlib>
#include <map>
#include <regex>
#include <sstream>

#include "heard.h"
#include "host.h"
#include "io/mcap.h"
#include "io/net.h"
#include "paths.h"
#include "program.h"

namespace crumple {
namespace {

using host::pose_at;

struct CloseNet {
  void operator()(Net* net) const { net_close(net); }
};
using Session = std::unique_ptr<Net, CloseNet>;

std::string with(std::string text, const std::string& from, const std::string& to) {
  EXPECT_NE(text.find(from), std::string::npos) << from;
  for (size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size()) text.replace(at, from.size(), to);
  return text;
}

std::string repository_file(const char* name) {
  std::ifstream file(in_repository(name));
  return {std::istreambuf_iterator<char>(file), {}};
}

class Operate : public Program {
 protected:
  // A session without the client library, because the library would keep to the rules.
  Session open_raw(const std::string& network = "") const {
    Net* net = nullptr;
    EXPECT_EQ(net_open("client", nullptr, endpoint.c_str(), network.empty() ? nullptr : network.c_str(), 30'000, &net), 0)
        << transport_error();
    return Session(net);
  }
  // Polls until the condition holds. `see` gets every event.
  static bool until_raw(const Session& net, const std::function<void(const NetEvent&)>& see,
                        const std::function<bool()>& condition) {
    const auto deadline = Clock::now() + patience;
    NetEvent events[256];
    while (!condition()) {
      const int got = net_poll(net.get(), events, 256, 50'000);
      if (got < 0 || Clock::now() > deadline) return false;
      for (int i = 0; i < got; ++i) see(events[i]);
    }
    return true;
  }
  static int put(const Session& net, const char* key, const Bytes& bytes) {
    return net_put(net.get(), key, bytes.data(), bytes.size(), NET_DATA);
  }
  // Returns the next Health for which the condition holds, with each count and refusal under its name.
  static std::map<std::string, uint64_t> counts_when(const Session& net,
                                                     const std::function<bool(std::map<std::string, uint64_t>&)>& condition) {
    std::map<std::string, uint64_t> counts;
    EXPECT_EQ(net_subscribe(net.get(), "crumple/1/main/health", 0, NET_LONGEST), 0);
    bool good = false;
    const auto see = [&](const NetEvent& event) {
      if (good || event.kind != NET_SAMPLE) return;
      const auto* data = reinterpret_cast<const std::byte*>(event.data);
      const Bytes bytes(data, data + event.size);
      const auto* health = host::read_as<schema::Health>(bytes);
      counts = {{"tick", health->tick()}};
      for (const auto* count : *health->counts()) counts[count->name()->str()] = count->value();
      for (const auto* count : *health->refusals()) counts["refused " + count->name()->str()] = count->value();
      good = condition(counts);
    };
    EXPECT_TRUE(until_raw(net, see, [&] { return good; })) << "no such health came";
    return counts;
  }
  // Returns the messages of a recording by topic, and the most messages of each topic in one tick.
  static std::map<std::string, std::pair<int, int>> topics(const std::string& recording) {
    std::map<std::string, std::pair<int, int>> all;
    std::map<std::string, std::map<uint32_t, int>> of_tick;
    Reader* reader = nullptr;
    EXPECT_EQ(reader_open(recording.c_str(), &reader), 0) << transport_error();
    for (ReaderMessage message; reader_next(reader, &message) == 1;) {
      auto& [sum, most] = all[message.topic];
      ++sum;
      most = std::max(most, ++of_tick[message.topic][message.sequence]);
    }
    reader_close(reader);
    return all;
  }
};

// ---- configuration ----------------------------------------------------------------------------------------------------------

TEST_F(Operate, OptionsComeFromAFileAndFlagsStand) {
  const std::string file = write("server.toml", "# two of our own\ncar = [\"" + car_file.string() +
                                                    "\"]\nlisten = \"tcp/127.0.0.1:0\"\nrate = 30\nthreads = 2\n");
  start({"serve", "--config", file, "--rate", "90"});
  EXPECT_NE(server->text.find("90 ticks a second, 2 threads"), std::string::npos) << server->text;
  // The check opens nothing, not even a port: the server above already listens on this port.
  const Outcome checked = run({"serve", "--config", file, "--listen", endpoint, "--check-config"});
  EXPECT_EQ(checked.code, 0) << checked.text;
  EXPECT_NE(checked.text.find("30 ticks a second, 2 threads"), std::string::npos) << checked.text;
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;
}

TEST_F(Operate, PrintedOptionsAreAFileThatSaysTheSame) {
  const Outcome printed = run({"serve", "--car", car_file.string(), "--rate", "90", "--print-config"});
  EXPECT_EQ(printed.code, 0) << printed.text;
  EXPECT_NE(printed.text.find("# ticks a second\nrate=90\n"), std::string::npos) << printed.text;
  const std::string help = run({"serve", "--help"}).text;
  const std::regex option("\\n +(?:-h,)?--([a-z-]+)");
  int options = 0;
  for (std::sregex_iterator i(help.begin(), help.end(), option), end; i != end; ++i) {
    const std::string name = (*i)[1];
    if (name == "help" || name.ends_with("config")) continue;
    EXPECT_NE(printed.text.find("\n" + name + "="), std::string::npos) << name << " is not printed\n" << printed.text;
    ++options;
  }
  EXPECT_GE(options, 11) << help;
  const std::string file = write("printed.toml", printed.text);
  EXPECT_EQ(run({"serve", "--config", file, "--print-config"}).text, printed.text);
  EXPECT_EQ(run({"serve", "--config", file, "--check-config"}).code, 0);
}

TEST_F(Operate, AWrongConfigurationIsRefusedWithFileFactAndRemedy) {
  const std::string car = "car = \"" + car_file.string() + "\"\n", network = path("network.json5");
  struct Case {
    std::string text, network, fact;
  };
  for (const Case& wrong : {Case{car + "nosuch = 1\n", "", "nosuch"},
                            {car + "[serve]\nrate = 30\n", "", "serve."},
                            {car + "rate = fast\n", "", "--rate"},
                            {car + "rate = 0\n", "", "--rate"},
                            {car + "config = \"other.toml\"\n", "", "config"},
                            {"rate = 30\n", "", "--car"},
                            {car + "network = \"nowhere.json5\"\n", "", "nowhere.json5"},
                            {car + "network = \"" + network + "\"\n", "{ not json", "network.json5"},
                            {car + "network = \"" + network + "\"\n", "{ nosuchkey: 1 }", "network.json5"}}) {
    write("network.json5", wrong.network);
    const Outcome outcome = run({"serve", "--config", write("wrong.toml", wrong.text), "--check-config"});
    EXPECT_EQ(outcome.code, 2) << wrong.text << outcome.text;
    for (const std::string& part : {std::string("wrong.toml"), wrong.fact, std::string("--print-config")})
      EXPECT_NE(outcome.text.find(part), std::string::npos) << part << "\n" << outcome.text;
  }
  const Outcome missing = run({"serve", "--config", path("missing.toml")});
  EXPECT_EQ(missing.code, 2);
  EXPECT_NE(missing.text.find("missing.toml"), std::string::npos) << missing.text;
  const Outcome no_car = run({"serve", "--car", write("no.car", "not a car"), "--check-config"});
  EXPECT_EQ(no_car.code, 1);
  EXPECT_NE(no_car.text.find("no.car"), std::string::npos) << no_car.text;
  const Outcome watch = run({"watch", "--network", path("missing.json5")});
  EXPECT_EQ(watch.code, 2);
  EXPECT_NE(watch.text.find("missing.json5"), std::string::npos) << watch.text;
}

// ---- who is let in, and to what ---------------------------------------------------------------------------------------------

// Sends messages that only servers may send: tokens of owners and standbys, inputs for standbys, and surfaces.
void intrude(const Session& net) {
  for (const char* token :
       {"owner/2-x", "owner/1000000000-x", "owner/18446744073709551615-x", "standby/0-0", "server", "car/ghost"})
    EXPECT_EQ(net_announce(net.get(), (std::string("crumple/1/main/") + token).c_str()), 0) << token;
  for (const char* key : {"replica/inputs", "car/box/key/0", "car/box/delta/0", "health", "host/tester/reactions"})
    EXPECT_EQ(net_put(net.get(), (std::string("crumple/1/main/") + key).c_str(), "forged", 6, NET_REAL_TIME), 0) << key;
  for (const char* key : {"asset", "car/*", "car/*/key/*", "inputs", "replica/world"})
    EXPECT_EQ(net_queryable(net.get(), (std::string("crumple/1/main/") + key).c_str(), 100, NET_LONGEST), 0) << key;
}

class Guarded : public Operate {
 protected:
  // A certificate authority with certificates, and a second authority.
  void SetUp() override {
    Operate::SetUp();
    std::ostringstream script;
    script << "set -e; cd " << folder.string() << "; exec >openssl.log 2>&1\n"
           << "new='-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes'\n"
           << "for ca in ca other; do openssl req -x509 $new -days 2 -subj /CN=$ca -keyout $ca.key -out $ca.pem; done\n"
           << "echo 'subjectAltName=DNS:localhost,IP:127.0.0.1' >names\n"
           << "for one in server:ca game:ca player:ca game2:other; do\n"
           << "  name=${one%:*} ca=${one#*:}\n"
           << "  openssl req -new $new -subj /CN=${name%2} -keyout $name.key -out $name.csr\n"
           << "  openssl x509 -req -in $name.csr -CA $ca.pem -CAkey $ca.key -CAcreateserial -days 2 -extfile names -out "
              "$name.pem\n"
           << "done\n";
    write("certificates", script.str());
    ASSERT_EQ(std::system(("sh " + path("certificates")).c_str()), 0) << "needs openssl; " << path("openssl.log");
    write("users", "game:dent-1\nplayer:look-1\nserver:serve-1\n");
  }

  // The example configurations of the repository, with the files of this folder.
  std::string server_network() const { return with(repository_file("server/network.json5"), "/etc/crumple", folder.string()); }
  std::string client_network() const { return with(repository_file("clients/network.json5"), "/etc/crumple", folder.string()); }
  std::string user(const std::string& name, const std::string& password) const {
    return with(with(client_network(), "\"player\"", "\"" + name + "\""), "as in the server's file of users", password);
  }
  std::string nobody() const { return with(client_network(), "    auth: {", "    // auth: {"); }
  std::string certificate(const std::string& name) const {
    const std::string shown = with(nobody(), "// enable_mtls", "enable_mtls");
    return with(with(shown, "player.key", name + ".key"), "player.pem", name + ".pem");
  }
  void start_guarded(const std::string& network) {
    start({"serve", "--car", car_file.string(), "--listen", "tls/127.0.0.1:0", "--threads", "2", "--record",
           path("guarded.mcap"), "--network", write("server.json5", network)});
    ASSERT_EQ(endpoint.substr(0, 4), "tls/") << server->text;
  }

  void expect_refused(const std::string& at, const std::string& network, const char* who) const {
    const CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 500, at.c_str(), "main", "game", network.c_str()};
    Crumple* session = nullptr;
    EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_CLOSED) << who << " was let in";
    EXPECT_NE(std::string(crumple_error()).find("cannot reach"), std::string::npos)
        << who << " has a connection, and is only told nothing: " << crumple_error();
    crumple_close(session);
  }

  // The host dents its car. A player sees the dent, and none of its other messages changes anything.
  void play(const std::string& game, const std::string& player) {
    Crumple* host = open("game", game);
    ASSERT_NE(host, nullptr);
    ASSERT_EQ(crumple_follow(host, "box", 0), CRUMPLE_OK);
    spawn(host);
    crash(host);
    if (HasFatalFailure()) return;
    Crumple* viewer = open(nullptr, player);
    ASSERT_NE(viewer, nullptr);
    ASSERT_EQ(crumple_follow(viewer, nullptr, 0), CRUMPLE_OK);
    EXPECT_TRUE(until(viewer, [&] { return hash_held(host) != 0 && hash_held(viewer) == hash_held(host); }));
    CrumpleMesh mesh{};
    EXPECT_TRUE(until(viewer, [&] { return crumple_mesh(viewer, asset.c_str(), &mesh) == CRUMPLE_OK; }));

    const Session intruder = open_raw(player);
    intrude(intruder);
    for (const char* key : {"host/*/poses", "host/game/reactions", "replica/inputs", "**"})
      ASSERT_EQ(net_subscribe(intruder.get(), (std::string("crumple/1/main/") + key).c_str(), 100, NET_LONGEST), 0);
    const Bytes order = host::despawn();
    uint64_t ticket = 0;
    for (const char* key : {"car/box", "car/*", "asset", "inputs", "replica/world"}) {
      bool ended = false, answered = false;
      ASSERT_EQ(
          net_get(intruder.get(), (std::string("crumple/1/main/") + key).c_str(), order.data(), order.size(), 300, &ticket), 0);
      ASSERT_TRUE(until_raw(
          intruder,
          [&](const NetEvent& event) {
            EXPECT_NE(event.kind, uint32_t{NET_SAMPLE}) << "a player hears " << event.key;
            answered |= event.kind == NET_REPLY && !event.failed;
            ended |= event.kind == NET_REPLY_END && event.ticket == ticket;
          },
          [&] { return ended; }));
      EXPECT_FALSE(answered) << key;
    }
    for (uint64_t i = 1; i <= 20; ++i) {
      put(intruder, "crumple/1/main/host/game/poses", host::poses(uint64_t{1} << 62, {{"box", pose_at(500)}}));
      put(intruder, "crumple/1/main/host/intruder/obstacles", host::obstacles(i, {{}}));
    }
    // A later query on the same link gets its answer, so the earlier messages would have arrived too if they were allowed.
    bool ended = false;
    ASSERT_EQ(net_get(intruder.get(), "crumple/1/main/car/box/key/0", nullptr, 0, 30'000, &ticket), 0);
    ASSERT_TRUE(until_raw(
        intruder, [&](const NetEvent& event) { ended |= event.kind == NET_REPLY && !event.failed; }, [&] { return ended; }));
    CrumpleSurface surface{};
    ASSERT_EQ(crumple_surface(host, "box", &surface), CRUMPLE_OK);
    EXPECT_TRUE(surface.alive);

    // A host must not use another host's id either.
    const Session other = open_raw(game);
    intrude(other);
    put(other, "crumple/1/main/host/intruder/obstacles", host::obstacles(1, {{}}));
    put(other, "crumple/1/main/host/intruder/poses", host::poses(uint64_t{1} << 62, {{"box", pose_at(500)}}));
    uint64_t answered = 0;
    CrumpleParameters keep = crumple_keep();
    EXPECT_TRUE(answer(host, crumple_set_parameters(host, "box", &keep, &answered), answered).ok);

    server->send(SIGTERM);
    EXPECT_EQ(server->wait(), 0) << server->text;
    auto seen = topics(path("guarded.mcap"));
    EXPECT_EQ(seen["crumple/1/main/host/game/poses"].first, 1) << "the host's own";
    for (const char* what : {"obstacles", "poses"})
      EXPECT_EQ(seen.count(std::string("crumple/1/main/host/intruder/") + what), 0u) << what;
    EXPECT_EQ(seen["crumple/1/main/car/box"].first, 2) << "spawn and parameters";
  }
};

TEST_F(Guarded, PasswordsLetAHostDriveAndAPlayerOnlyWatch) {
  start_guarded(server_network());
  expect_refused(endpoint, user("game", "wrong"), "a wrong password");
  expect_refused(endpoint, user("nobody", "dent-1"), "a user that is not in the file");
  expect_refused(endpoint, nobody(), "no user");
  expect_refused(endpoint, with(user("game", "dent-1"), "ca.pem", "other.pem"), "a server of another authority");
  expect_refused("tcp" + endpoint.substr(3), "", "no TLS");
  play(user("game", "dent-1"), user("player", "look-1"));
}

TEST_F(Guarded, CertificatesLetAHostDriveAndAPlayerOnlyWatch) {
  std::string network = with(server_network(), "// enable_mtls", "enable_mtls");
  network = with(with(network, "    auth: {", "    // auth: {"), "usernames", "cert_common_names");
  start_guarded(network);
  expect_refused(endpoint, nobody(), "no certificate");
  expect_refused(endpoint, certificate("game2"), "a certificate of another authority");
  play(certificate("game"), certificate("player"));
}

TEST_F(Guarded, ThoseWhoSpeakNoTlsKeepNobodyOut) {
  start_guarded(server_network());
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(static_cast<uint16_t>(std::stoi(endpoint.substr(endpoint.rfind(':') + 1))));
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  std::vector<int> strangers;
  for (int i = 0; i < 300; ++i) {
    strangers.push_back(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    ASSERT_EQ(connect(strangers.back(), reinterpret_cast<const sockaddr*>(&to), sizeof to), 0) << std::strerror(errno);
    ASSERT_GT(send(strangers.back(), "GET / HTTP/1.1\r\n\r\n", 18, MSG_NOSIGNAL), 0) << std::strerror(errno);
  }
  const std::string network = user("game", "dent-1");
  const CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 10'000, endpoint.c_str(), "main", "game", network.c_str()};
  Crumple* session = nullptr;
  EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_OK) << crumple_error();
  crumple_close(session);
  for (const int stranger : strangers) close(stranger);
}

// One user has at most half of the sessions, so it cannot keep the others out.
TEST_F(Guarded, AUserWhoOpensSessionsWithoutEndKeepsNoOtherUserOut) {
  constexpr int most = 8;
  start_guarded(
      with(server_network(), "transport: {", "transport: { unicast: { max_sessions: " + std::to_string(most) + " },"));
  std::vector<Session> players;
  int refused = 0;
  for (int i = 0; i < most; ++i) {
    Net* opened = nullptr;
    refused += net_open("client", nullptr, endpoint.c_str(), user("player", "look-1").c_str(), 300, &opened) != 0;
    players.emplace_back(opened);
  }
  EXPECT_EQ(refused, most / 2);
  Crumple* host = open("game", user("game", "dent-1"));
  ASSERT_NE(host, nullptr) << crumple_error();
  spawn(host);
}

// The same as Door.ViewersThatFreeze..., with TLS: a link with TLS is closed by other code.
TEST_F(Guarded, ViewersThatFreezeUntilTheirLinksExpireDeafenNobody) {
  const auto join = [&](const char* mode, const char* listen, const char* connect, const std::string& network) {
    Net* opened = nullptr;
    EXPECT_EQ(net_open(mode, listen, connect, network.c_str(), 10'000, &opened), 0) << transport_error();
    return Session(opened);
  };
  const Session owner = join("peer", "tls/127.0.0.1:0", nullptr, server_network());
  const char* at = net_endpoint(owner.get());
  const Session host = join("client", nullptr, at, user("game", "dent-1"));
  const std::string network = write("player.json5", user("player", "look-1"));
  const auto frozen = freeze_viewers(owner.get(), {"watch", "--network", network, "--connect", at});
  EXPECT_LT(longest_unheard(host.get(), owner.get()), 3) << "a host was unheard";
}

class Routed : public Guarded {
 protected:
  Session route() {
    Net* opened = nullptr;
    const std::string network = with(repository_file("server/router.json5"), "/etc/crumple", folder.string());
    EXPECT_EQ(net_open("router", "tls/127.0.0.1:0", nullptr, network.c_str(), 0, &opened), 0) << transport_error();
    endpoint = net_endpoint(opened);
    return Session(opened);
  }
  std::unique_ptr<Process> serve(const char* name, const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"serve",     "--car",     car_file.string(),
                                          "--threads", "2",         "--connect",
                                          endpoint,    "--network", write("as_server.json5", user("server", "serve-1")),
                                          "--record",  path(name)};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return std::make_unique<Process>(arguments);
  }
};

// It has more bytes than Zenoh's queue for a link.
TEST_F(Routed, AStandbyFetchesAWorldOfAThousandCars) {
  const Session router = route();
  const auto owner = serve("owner.mcap", {});
  ASSERT_TRUE(owner->read_until("vertices")) << owner->text;
  Crumple* host = open("game", user("game", "dent-1"));
  ASSERT_NE(host, nullptr);
  for (int i = 0; i < 1000; ++i) {
    CrumpleSpawn spawn{};
    spawn.pose = {{100.0 * i, 0, 0}, {0, 0, 0, 1}};
    uint64_t ticket = 0;
    const std::string id = "car" + std::to_string(i);
    const int sent = crumple_spawn(host, id.c_str(), asset.c_str(), &spawn, &ticket);
    ASSERT_TRUE(i % 50 != 49 ? sent == CRUMPLE_OK : answer(host, sent, ticket).ok) << id;
  }
  const auto standby = serve("standby.mcap", {"--standby"});
  EXPECT_TRUE(standby->read_until("holds the world")) << standby->text;
  EXPECT_NE(standby->text.find("1000 cars"), std::string::npos) << standby->text;
}

TEST_F(Routed, APlayerWhoAsksWithFiftyMegabytesDeafensNobody) {
  const Session router = route();
  const auto join = [&](const char* name, const char* password) {
    Net* opened = nullptr;
    EXPECT_EQ(net_open("client", nullptr, endpoint.c_str(), user(name, password).c_str(), 10'000, &opened), 0)
        << transport_error();
    return Session(opened);
  };
  const Session owner = join("server", "serve-1"), host = join("game", "dent-1"), player = join("player", "look-1");
  ASSERT_EQ(net_queryable(owner.get(), "crumple/1/main/car/*/key/*", 100, NET_LONGEST), 0);
  ASSERT_EQ(net_subscribe(owner.get(), heard_key, 1000, NET_LONGEST), 0);
  const std::string long_one(50 << 20, 'x');
  std::chrono::duration<double> longest{};
  uint64_t ticket = 0;
  for (uint64_t said = 1; said < 300; ++said) {
    if (said == 50) {
      EXPECT_EQ(net_get(player.get(), "crumple/1/main/car/x/key/0", long_one.data(), long_one.size(), 5'000, &ticket), 0);
    }
    longest = std::max(longest, until_heard(host.get(), owner.get(), said));
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EXPECT_LT(longest.count(), 1) << "a host was unheard";
  std::printf("a host was unheard for %.3f s at most\n", longest.count());
}

TEST_F(Routed, OnlyServersOwnAScene) {
  const Session router = route();
  const auto owner = serve("owner.mcap", {});
  ASSERT_TRUE(owner->read_until("vertices")) << owner->text;
  const Session player = open_raw(user("player", "look-1")), game = open_raw(user("game", "dent-1"));
  intrude(player);
  intrude(game);
  const auto standby = serve("standby.mcap", {"--standby"});
  ASSERT_TRUE(standby->read_until("holds the world")) << owner->text << standby->text;
  Crumple* host = open("game", user("game", "dent-1"));
  ASSERT_NE(host, nullptr);
  ASSERT_EQ(crumple_follow(host, "box", 0), CRUMPLE_OK);
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  intrude(player);
  owner->send(SIGKILL);
  ASSERT_TRUE(standby->read_until("takes over")) << standby->text;
  CrumpleParameters keep = crumple_keep();
  uint64_t ticket = 0;
  EXPECT_TRUE(until(host, [&] {
    return crumple_set_parameters(host, "box", &keep, &ticket) == CRUMPLE_OK && answer(host, CRUMPLE_OK, ticket).ok;
  })) << "it serves on";
  EXPECT_EQ(standby->text.find("differs from the owner"), std::string::npos) << standby->text;
  standby->send(SIGTERM);
  EXPECT_EQ(standby->wait(), 0) << standby->text;
}

TEST_F(Operate, ListeningToStrangersIsSaidAloud) {
  server =
      std::make_unique<Process>(std::vector<std::string>{"serve", "--car", car_file.string(), "--listen", "tcp/0.0.0.0:0"});
  EXPECT_TRUE(server->read_until("ticks a second")) << server->text;
  EXPECT_NE(server->text.find("--network"), std::string::npos) << server->text;
  server =
      std::make_unique<Process>(std::vector<std::string>{"serve", "--car", car_file.string(), "--listen", "tcp/127.0.0.1:0"});
  EXPECT_TRUE(server->read_until("ticks a second")) << server->text;
  EXPECT_EQ(server->text.find("--network"), std::string::npos) << server->text;
}

// ---- metrics ----------------------------------------------------------------------------------------------------------------

int connect_to(const std::string& address) {
  sockaddr_in to{};
  to.sin_family = AF_INET;
  const size_t colon = address.find(':');
  to.sin_port = htons(static_cast<uint16_t>(std::stoi(address.substr(colon + 1))));
  EXPECT_EQ(inet_pton(AF_INET, address.substr(0, colon).c_str(), &to.sin_addr), 1) << address;
  const int socket = ::socket(AF_INET, SOCK_STREAM, 0);
  EXPECT_EQ(connect(socket, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0) << address;
  return socket;
}

// Returns the whole answer, head and body.
std::string get(const std::string& address, const std::string& what) {
  const int socket = connect_to(address);
  const std::string request = "GET " + what + " HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n";
  EXPECT_EQ(send(socket, request.data(), request.size(), 0), ssize_t(request.size()));
  std::string text;
  char chunk[4096];
  for (ssize_t size; (size = recv(socket, chunk, sizeof chunk, 0)) > 0;) text.append(chunk, static_cast<size_t>(size));
  close(socket);
  return text;
}

// Every line of the format must be a comment or a sample, and HELP and TYPE must precede the samples of a metric.
std::map<std::string, double> parse(const std::string& answer) {
  std::map<std::string, double> samples;
  std::map<std::string, int> told;
  std::istringstream lines(answer.substr(answer.find("\r\n\r\n") + 4));
  const std::regex comment("# (HELP|TYPE) (crumple_[a-z_]+) .+"), sample("(crumple_[a-z_]+)(\\{[^}]*\\})? ([0-9.e+-]+)");
  for (std::string line; std::getline(lines, line);) {
    std::smatch match;
    if (std::regex_match(line, match, comment)) {
      ++told[match[2]];
    } else if (std::regex_match(line, match, sample)) {
      EXPECT_EQ(told[match[1]], 2) << line;
      EXPECT_TRUE(samples.emplace(match[1].str() + match[2].str(), std::stod(match[3])).second) << line << " twice";
    } else {
      ADD_FAILURE() << "not of the text format: " << line;
    }
  }
  return samples;
}

TEST_F(Operate, PrometheusReadsWhatHealthSays) {
  start_server(path("metrics.mcap"), {"--metrics", "127.0.0.1:0"});
  ASSERT_TRUE(server->read_until("/metrics\n")) << server->text;
  const size_t at = server->text.find("http://") + 7;
  const std::string address = server->text.substr(at, server->text.find("/metrics", at) - at);
  const int silent = connect_to(address);  // a connection without a request delays nobody

  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  CrumpleSpawn again{};
  again.pose.orientation[3] = 1;
  uint64_t ticket = 0;
  EXPECT_FALSE(answer(host, crumple_spawn(host, "box", asset.c_str(), &again, &ticket), ticket).ok);

  // The server updates the page with every Health. If both have the same tick, all counts must be equal.
  const Session net = open_raw();
  std::string page;
  std::map<std::string, double> metrics;
  const auto counts = counts_when(net, [&](std::map<std::string, uint64_t>& health) {
    if (health["refused already_there"] == 0) return false;
    page = get(address, "/metrics");
    metrics = parse(page);
    return metrics["crumple_ticks_total"] == double(health["tick"]);
  });
  EXPECT_TRUE(page.starts_with("HTTP/1.1 200 OK\r\n")) << page;
  EXPECT_NE(page.find("content-type: text/plain; version=0.0.4"), std::string::npos) << page;
  size_t listed = 0, shown = 0;
  for (const auto& [name, value] : counts) listed += name != "tick" && !name.starts_with("refused ");
  for (const auto& [name, value] : metrics) shown += name.find('{') == name.npos && !name.ends_with("_limit");
  EXPECT_EQ(shown, listed + 4) << "a count of health is not on the page, which has ticks, late ticks, rate and refused besides";
  EXPECT_NE(page.find("crumple_info{scene=\"main\",program=\"crumple "), std::string::npos) << page;
  EXPECT_EQ(metrics["crumple_cars"], 1);
  EXPECT_EQ(metrics["crumple_cars_limit"], 1000);
  EXPECT_EQ(metrics["crumple_obstacles"], 1);
  EXPECT_EQ(metrics["crumple_ticks_per_second"], 60);
  EXPECT_EQ(metrics["crumple_refusals_total{reason=\"already_there\"}"], 1);
  EXPECT_EQ(metrics["crumple_refusals_total{reason=\"malformed\"}"], 0);
  EXPECT_GT(metrics["crumple_room_mean_seconds{room=\"tick\"}"], 0);
  EXPECT_GE(metrics["crumple_room_worst_seconds{room=\"tick\"}"], metrics["crumple_room_mean_seconds{room=\"tick\"}"]);
  EXPECT_EQ(metrics["crumple_messages_total"], double(counts.at("messages")));
  EXPECT_EQ(metrics["crumple_sent_bytes_total"], double(counts.at("sent_bytes")));
  size_t refusals = 0;
  for (const auto& [name, value] : counts) {
    if (!name.starts_with("refused ")) continue;
    EXPECT_EQ(metrics["crumple_refusals_total{reason=\"" + name.substr(8) + "\"}"], double(value)) << name;
    ++refusals;
  }
  EXPECT_GT(refusals, 10u);

  EXPECT_TRUE(get(address, "/").starts_with("HTTP/1.1 404")) << get(address, "/");
  close(silent);
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;
  const Outcome taken = run({"serve", "--car", car_file.string(), "--listen", "tcp/127.0.0.1:0", "--metrics", "nonsense"});
  EXPECT_EQ(taken.code, 1);
  EXPECT_NE(taken.text.find("HOST:PORT"), std::string::npos) << taken.text;
}

TEST_F(Operate, TheDashboardAsksForMetricsThatThereAre) {
  start_server(path("dashboard.mcap"), {"--metrics", "127.0.0.1:0"});
  ASSERT_TRUE(server->read_until("/metrics\n")) << server->text;
  const size_t at = server->text.find("http://") + 7;
  const std::string address = server->text.substr(at, server->text.find("/metrics", at) - at);
  std::string page;
  ASSERT_TRUE(until(open(), [&] { return (page = get(address, "/metrics")).find("crumple_ticks_total ") != page.npos; }));
  const std::string dashboard = repository_file("server/grafana.json");
  const std::regex name("crumple_[a-z_]+");
  std::set<std::string> asked;
  for (std::sregex_iterator i(dashboard.begin(), dashboard.end(), name), end; i != end; ++i) asked.insert(i->str());
  EXPECT_GE(asked.size(), 8u);
  for (const std::string& one : asked) EXPECT_NE(page.find("# TYPE " + one + " "), std::string::npos) << one;
}

// ---- its end ----------------------------------------------------------------------------------------------------------------

TEST_F(Operate, ATerminatedServerClosesItsRecordingAndViewersSeeItGo) {
  start_server(path("%Y-ended.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  ASSERT_EQ(crumple_follow(host, "box", 0), CRUMPLE_OK);
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  CrumpleSurface surface{};
  ASSERT_TRUE(until(host, [&] { return crumple_surface(host, "box", &surface) == CRUMPLE_OK && surface.alive; }));
  server->send(SIGTERM);
  EXPECT_TRUE(until(host, [&] { return crumple_surface(host, "box", &surface) == CRUMPLE_OK && !surface.alive; }));
  EXPECT_EQ(server->wait(), 0) << server->text;
  const size_t at = server->text.find("recorded ");
  ASSERT_NE(at, std::string::npos) << server->text;
  const std::string file = server->text.substr(at + 9, server->text.find('\n', at) - at - 9);
  EXPECT_EQ(file.find('%'), std::string::npos) << "the year of its start stands in its name";
  const Outcome outcome = run({"replay", file, "--verify"});
  EXPECT_EQ(outcome.code, 0) << outcome.text;
  EXPECT_NE(outcome.text.find("every tick identical"), std::string::npos) << outcome.text;
  EXPECT_EQ(outcome.text.find("cut off"), std::string::npos) << outcome.text;
}

TEST_F(Operate, TheUnitOfSystemdIsOne) {
  if (std::system("systemd-analyze --version >/dev/null 2>&1") != 0) GTEST_SKIP() << "systemd-analyze is not here";
  const std::string unit = with(repository_file("server/crumple.service"), "/usr/local/bin/crumple", program_path());
  const std::string said = path("said");
  const int code = std::system(("systemd-analyze verify " + write("crumple.service", unit) + " >" + said + " 2>&1").c_str());
  std::ifstream file(said);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  EXPECT_EQ(code, 0) << text;
  EXPECT_EQ(text.find("crumple.service"), std::string::npos) << text;
}

TEST_F(Operate, CarsThatCameAndWentLeaveNothingBehind) {
  start_server(path("guests.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  const Session net = open_raw();
  CrumpleSpawn spawn{};
  spawn.pose.orientation[3] = 1;
  for (int k = 0; k < 40; ++k) {
    const std::string id = "guest-" + std::to_string(k);
    uint64_t ticket = 0;
    EXPECT_TRUE(answer(host, crumple_spawn(host, id.c_str(), asset.c_str(), &spawn, &ticket), ticket).ok);
    EXPECT_TRUE(answer(host, crumple_despawn(host, id.c_str(), &ticket), ticket).ok);
  }
  // A second later the keys of the host's reactions and the cars' keyframes must be gone. Only health and the inputs for
  // standbys remain.
  const auto after = counts_when(net, [&](auto& health) { return health["messages"] >= 80 && health["hosts"] == 0; });
  EXPECT_LE(after.at("keys_published"), 2u);
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;
}

// ---- what a tick takes ------------------------------------------------------------------------------------------------------

// Viewers may ask for baked cars and keyframes, also where they may not command.
TEST_F(Operate, AFloodOfQuestionsHoldsUpNoCommand) {
  start_server("");
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  spawn(host);
  const Session net = open_raw();
  constexpr int asked = 4000;
  for (const char* key : {"crumple/1/asset/0000000000000000", "crumple/1/main/car/none/key/0"}) {
    int ended = 0, refused = 0;
    for (int i = 0; i < asked; ++i) {
      uint64_t ticket = 0;
      ASSERT_EQ(net_get(net.get(), key, nullptr, 0, 60'000, &ticket), 0) << transport_error();
    }
    for (int i = 0; i < 20; ++i) {
      uint64_t ticket = 0;
      ASSERT_EQ(crumple_save(host, "box", &ticket), CRUMPLE_OK);
      CrumpleAnswer answer{};
      ASSERT_EQ(crumple_wait(host, ticket, &answer), CRUMPLE_OK) << key;
      EXPECT_TRUE(answer.ok) << key << ": " << answer.sentence;
    }
    const auto see = [&](const NetEvent& event) {
      ended += event.kind == NET_REPLY_END;
      refused += event.kind == NET_REPLY &&
                 std::string_view(reinterpret_cast<const char*>(event.data), event.size).find("too many questions wait") !=
                     std::string_view::npos;
    };
    EXPECT_TRUE(until_raw(net, see, [&] { return ended == asked; })) << ended;
    EXPECT_GT(refused, 0) << key << ": the line was never full";
  }
}

TEST_F(Operate, NoSenderMakesATickLong) {
  start_server(path("flood.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  spawn(host);
  const Session net = open_raw();
  // 4000 poses and one that is too long.
  for (uint64_t i = 1; i <= 4000; ++i) put(net, "crumple/1/main/host/tester/poses", host::poses(i, {{"box", pose_at(0)}}));
  put(net, "crumple/1/main/host/tester/obstacles", Bytes((size_t{1} << 20) + 1));
  // 5000 commands at once: each must end, with an answer as long as there is room for answers on the way to the asker.
  const Bytes order = host::save();
  constexpr int asked = 5000;
  int done = 0, ended = 0, refused = 0;
  for (int i = 0; i < asked; ++i) {
    uint64_t ticket = 0;
    ASSERT_EQ(net_get(net.get(), "crumple/1/main/car/box", order.data(), order.size(), 60'000, &ticket), 0)
        << transport_error();
  }
  const auto see = [&](const NetEvent& event) {
    ended += event.kind == NET_REPLY_END;
    if (event.kind != NET_REPLY) return;
    const std::string_view text(reinterpret_cast<const char*>(event.data), event.size);
    (event.failed ? refused : done) += 1;
    EXPECT_EQ(event.failed != 0, text.find("too many questions wait") != text.npos) << text;
  };
  EXPECT_TRUE(until_raw(net, see, [&] { return ended == asked; })) << ended;
  EXPECT_LE(done + refused, asked);
  EXPECT_GE(done, 1000) << "so many may wait";
  EXPECT_GT(refused, 0);
  auto counts = counts_when(net, [](auto& health) { return health["oversized"] > 0 && health["queries_refused"] > 0; });
  EXPECT_EQ(counts["oversized"], 1u);
  EXPECT_EQ(counts["queries_refused"], uint64_t(refused));
  EXPECT_EQ(counts["queries_waiting"], 0u);
  EXPECT_GT(counts["replaced"], 0u);
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;
  auto seen = topics(path("flood.mcap"));
  EXPECT_LE(seen["crumple/1/main/car/box"].second, 16) << "commands in one tick";
  EXPECT_EQ(seen["crumple/1/main/host/tester/poses"].second, 1) << "poses of a host in one tick";
  EXPECT_EQ(run({"replay", path("flood.mcap"), "--verify"}).code, 0);
}

// Messages of a host may overtake each other, for example when it comes back over another link. The tick refuses the older
// ones; those that wait for the same tick must fare no differently.
TEST_F(Operate, OfMessagesThatWaitForTheSameTickTheNewestStays) {
  start_server(path("overtaken.mcap"), {"--rate", "2"});
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  spawn(host);
  const Session net = open_raw();
  const auto walls = [](size_t count) {
    std::vector<host::Thing> things(count);
    for (uint32_t i = 0; i < count; ++i) things[i] = {i + 1, schema::Shape::sphere, {1, 0, 0}, pose_at(100 + 5 * i)};
    return things;
  };
  for (const uint64_t sequence : {5u, 4u, 7u, 6u}) {
    put(net, "crumple/1/main/host/tester/obstacles", host::obstacles(sequence, walls(sequence)));
    put(net, "crumple/1/main/host/tester/poses", host::poses(sequence, {{"box", pose_at(double(sequence))}}));
  }
  put(net, "crumple/1/main/host/tester/obstacles", Bytes(3));
  // If a tick began among them, it has refused some itself.
  auto counts =
      counts_when(net, [](auto& health) { return health["refused stale_sequence"] + health["refused malformed"] >= 5; });
  EXPECT_GE(counts["refused stale_sequence"], 4u) << "4 and 6 of each";
  EXPECT_EQ(counts["refused stale_sequence"] + counts["refused malformed"], 5u) << "and one that is no message";
  EXPECT_EQ(counts["obstacles"], 7u);

  // A viewer that comes late gets what the tick took.
  bool ended = false;
  uint64_t ticket = 0;
  std::map<std::string, Bytes> latest;
  ASSERT_EQ(net_get(net.get(), "crumple/1/main/inputs", nullptr, 0, 30'000, &ticket), 0);
  const auto see = [&](const NetEvent& event) {
    ended |= event.kind == NET_REPLY_END;
    if (event.kind != NET_REPLY || event.failed) return;
    const auto* data = reinterpret_cast<const std::byte*>(event.data);
    const Bytes bytes(data, data + event.size);
    for (const auto* input : *host::read_as<schema::Inputs>(bytes)->inputs()) {
      const auto* payload = reinterpret_cast<const std::byte*>(input->payload()->data());
      latest[input->key()->str()] = {payload, payload + input->payload()->size()};
    }
  };
  ASSERT_TRUE(until_raw(net, see, [&] { return ended; }));
  ASSERT_EQ(latest.size(), 2u);
  EXPECT_EQ(host::read_as<schema::Obstacles>(latest["host/tester/obstacles"])->sequence(), 7u);
  EXPECT_EQ(host::read_as<schema::Poses>(latest["host/tester/poses"])->sequence(), 7u);
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;
  EXPECT_EQ(run({"replay", path("overtaken.mcap"), "--verify"}).code, 0);
}

}  // namespace
}  // namespace crumple
