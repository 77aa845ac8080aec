// Gives sessions their handles, and keeps the sentence of the last error.
#include <cstring>
#include <exception>
#include <memory>
#include <mutex>
#include <new>
#include <shared_mutex>
#include <stdexcept>
#include <unordered_map>
#include <utility>

#include "cpp/session.h"
#include "protocol/key.h"

namespace crumple::client {
namespace {

thread_local std::string last_error;

struct Sessions {
  std::shared_mutex lock;
  std::unordered_map<const Crumple*, std::unique_ptr<Crumple>> all;
  uintptr_t last = 0;
};

// Never destroyed: a game may close its session after the end of main.
Sessions& sessions() {
  static auto* all = new Sessions;
  return *all;
}

}  // namespace

int fail(int status, std::string sentence) {
  last_error = std::move(sentence);
  return status;
}

bool is_id(const char* text) { return text && crumple::is_id(std::string_view(text, strnlen(text, id_length_limit + 1))); }

Crumple* find(const Crumple* handle) {
  Sessions& known = sessions();
  {
    const std::shared_lock hold(known.lock);
    if (const auto at = known.all.find(handle); at != known.all.end()) return at->second.get();
  }
  fail(CRUMPLE_BAD_ARGUMENT, handle ? "the session was closed, or was never open: crumple_open opens one"
                                    : "session is NULL: crumple_open opens one");
  return nullptr;
}

Crumple* keep(std::unique_ptr<Crumple> session) {
  Sessions& known = sessions();
  const std::unique_lock hold(known.lock);
  const auto handle = reinterpret_cast<Crumple*>(16 * ++known.last);
  known.all.emplace(handle, std::move(session));
  return handle;
}

bool not_null(std::initializer_list<Argument> needed) {
  for (const Argument& argument : needed) {
    if (argument.value) continue;
    fail(CRUMPLE_BAD_ARGUMENT, std::string(argument.name) + " is NULL: crumple_client.h says what to give");
    return false;
  }
  return true;
}

int fail_by(const std::exception* thrown) noexcept {
  if (!dynamic_cast<const std::bad_alloc*>(thrown) && !dynamic_cast<const std::length_error*>(thrown)) try {
      last_error = thrown ? thrown->what() : "something was thrown that is no exception of C++";
      return CRUMPLE_FAILED;
    } catch (const std::bad_alloc&) {  // there is no room for the sentence
    }
  last_error.assign("no memory");  // short enough to take none itself
  return CRUMPLE_NO_MEMORY;
}

}  // namespace crumple::client

using namespace crumple::client;

const char* crumple_error(void) { return last_error.c_str(); }

void crumple_close(Crumple* handle) {
  if (!handle) return;
  with(handle, {}, [&](Crumple*) {
    Sessions& known = sessions();
    std::unique_lock hold(known.lock);
    const auto closed = known.all.extract(handle);
    hold.unlock();  // others need not wait until a line is closed
    return CRUMPLE_OK;
  });
}
