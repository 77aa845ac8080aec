#include "bake/parts_text.h"

#include <flatbuffers/idl.h>
#include <flatbuffers/util.h>

#include <stdexcept>

#include "io/files.h"

// PARTS_BFBS: schema/parts.fbs and its includes, compiled by flatc.
asm(".pushsection .rodata\n.balign 8\nparts_schema:\n.incbin \"" PARTS_BFBS "\"\nparts_schema_end:\n.popsection");
extern "C" const uint8_t parts_schema[], parts_schema_end[];

namespace crumple {
namespace {

void load_schema(flatbuffers::Parser& parser) {
  if (!parser.Deserialize(parts_schema, static_cast<size_t>(parts_schema_end - parts_schema)))
    throw std::runtime_error("the parts schema inside this program is damaged: build it again");
}

}  // namespace

PartsText read_parts(const std::filesystem::path& file) {
  return {file.string(), read_file(file, text_limit, "give a parts file, in the form of schema/parts.fbs")};
}

// FlatBuffers' own parser converts the JSON to a table. Its error message begins with file and line.
schema::PartEntriesT parse_parts(const PartsText& text) {
  flatbuffers::Parser parser;
  load_schema(parser);
  if (!parser.ParseJson(text.text.c_str(), text.source.c_str()))
    throw std::runtime_error(parser.error_ + " (the form of a parts file: schema/parts.fbs, with an example).");
  schema::PartEntriesT entries;
  flatbuffers::GetRoot<schema::PartEntries>(parser.builder_.GetBufferPointer())->UnPackTo(&entries);
  return entries;
}

std::string write_parts(const schema::PartEntriesT& entries) {
  flatbuffers::Parser parser;
  load_schema(parser);
  parser.opts.strict_json = true;
  flatbuffers::FlatBufferBuilder builder;
  builder.Finish(schema::PartEntries::Pack(builder, &entries));
  std::string text;
  if (const char* why = flatbuffers::GenText(parser, builder.GetBufferPointer(), &text))
    throw std::runtime_error(std::string("the parts cannot be written as a text: ") + why);
  return text;
}

}  // namespace crumple
