#!/bin/sh
# Does what a game's developer does: installs the client library, finds it by find_package, and builds the example of its manual.
# Then does what an operator does: installs the program and starts it from the place of installation.
#   install_test.sh BUILD_FOLDER SOURCE_FOLDER
set -eu
build=$1 source=$2
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cmake --install "$build" --prefix "$folder/installed" >"$folder/log" || { cat "$folder/log"; exit 1; }
mkdir "$folder/game"
cat >"$folder/game/CMakeLists.txt" <<'GAME'
cmake_minimum_required(VERSION 3.25)
project(game LANGUAGES CXX)
set(CMAKE_CXX_STANDARD 20)
find_package(crumple_client 0.1 REQUIRED)
add_executable(game ${EXAMPLE})
target_link_libraries(game PRIVATE crumple::crumple_client)
GAME
cmake -G Ninja -S "$folder/game" -B "$folder/game/build" -DEXAMPLE="$source/clients/cpp/examples/viewer.cpp" \
  -DCMAKE_PREFIX_PATH="$folder/installed" >"$folder/log" 2>&1 && cmake --build "$folder/game/build" >>"$folder/log" 2>&1 ||
  { cat "$folder/log"; exit 1; }
said=$("$folder/game/build/game" 2>&1) && { echo "the example needs arguments, and ended with 0: $said"; exit 1; }
case $said in *ENDPOINT*) ;; *) echo "the example said: $said"; exit 1 ;; esac
"$folder/installed/bin/crumple" --version
"$folder/installed/bin/crumple" watch --help | grep -q "A viewer"
test -s "$folder/installed/lib/crumple/web/index.html"
