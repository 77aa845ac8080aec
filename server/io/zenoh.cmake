# Three of zenoh's crates with zenoh.patch, fetched by name from wherever this machine's cargo fetches. CMakeLists.txt runs this
# with CARGO, PATCH, HERE (this folder) and INTO (where they go: a folder of this patch's own, so that no builds meet there).
set(checksums # of the crates as they are published; a crate from a path has none in Cargo.lock
  zenoh-1.10.2 946b0c49f30d9d5a29c13d9fe258ca2f14e9457018d145b9392df3bc49f84baa
  zenoh-link-tls-1.10.2 c68bd5c4869ca5ff15e5e87602aa02b576b6317bfad9e047cecddac9da834b04
  zenoh-transport-1.10.2 b652b7a1a79d23b601920b425747d60c4838f44d64151bf77a963f7508de739b)

# Its name says what is in it. Made anew, it would be newer than what cargo built of it.
if(EXISTS "${INTO}/Cargo.toml")
  return()
endif()

# Without the patch cargo takes them from the registry again, and the rest as Cargo.lock has it.
string(RANDOM LENGTH 8 mine)
set(work "${INTO}.${mine}")
file(COPY "${HERE}/Cargo.toml" "${HERE}/Cargo.lock" DESTINATION "${work}")
file(WRITE "${work}/src/lib.rs" "")
execute_process(COMMAND "${CARGO}" metadata --format-version 1 --filter-platform x86_64-unknown-linux-gnu
  WORKING_DIRECTORY "${work}" OUTPUT_VARIABLE metadata COMMAND_ERROR_IS_FATAL ANY)
file(READ "${work}/Cargo.lock" lock)

while(checksums)
  list(POP_FRONT checksums crate checksum)
  if(NOT lock MATCHES "${checksum}" OR NOT metadata MATCHES "\"manifest_path\":\"([^\"]*/${crate})/Cargo.toml\"")
    message(FATAL_ERROR "zenoh.patch is for ${crate} with checksum ${checksum}: Cargo.lock has another")
  endif()
  file(COPY "${CMAKE_MATCH_1}" DESTINATION "${work}")
endwhile()
execute_process(COMMAND "${PATCH}" --strip 1 --fuzz 0 --input "${HERE}/zenoh.patch"
  WORKING_DIRECTORY "${work}" COMMAND_ERROR_IS_FATAL ANY)
file(REMOVE_RECURSE "${INTO}")
file(RENAME "${work}" "${INTO}")
