"""The reference of the protocol: writes the part of schema/README.md below MARK from the schema files and their comments.

    python schema/reference.py            writes it
    python schema/reference.py --check    says whether it is up to date

A `///` comment describes what follows it, a comment at a line's end describes the field before it.
"""

import pathlib
import re
import sys

FOLDER = pathlib.Path(__file__).parent
MARK = "<!-- schema/reference.py writes everything below from the schema files -->"
TITLES = {
    "message": "Messages",
    "geometry": "Shapes shared by all",
    "car": "The baked car",
    "regions": "The regions file",
    "parts": "The parts file",
    "scene": "Scenes and presets",
}
TOKEN = re.compile(r"//[^\n]*|\b(?:table|struct|enum|union)\s+\w+[^{]*\{|\}")


def text_of(comment):
    return comment.lstrip("/").strip()


def escaped(text):
    return text.replace("|", "\\|").replace("<", "&lt;")


def fields(body):
    """Rows of a table or struct: name, type with default, comment. A row without a name is a comment on the fields below it."""
    rows, said, part = [], [], []
    for line in map(str.strip, body.split("\n")):
        code, slashes, comment = re.fullmatch(r"(.*?)(?:\s*(//+)\s*(.*))?", line).groups()
        if comment and not code:
            (said if slashes == "///" else part).append(comment)
        for statement in filter(None, map(str.strip, code.split(";"))):
            field = re.fullmatch(r"(\w+)\s*:\s*([^=(]+?)\s*(?:=\s*([^(]+?)\s*)?(\(required\))?", statement)
            if not field:
                sys.exit(f"schema/reference.py cannot read: {line}")
            name, type_, default, required = field.groups()
            default = {None: "", "null": ", or absent"}.get(default, f" = {default}")
            if part:
                rows.append(("", "", " ".join(part)))
            rows.append((f"`{name}`", f"`{type_}`{', required' if required else default}", " ".join([*said, comment or ""]).strip()))
            said, part = [], []
    return rows


def declarations(text):
    """In the file's order: ("section", title), or (kind, name, base, body, doc)."""
    at, doc = 0, []
    while found := TOKEN.search(text, at):
        token, at = found.group(), found.end()
        if section := re.match(r"// -+ (.+?) -+$", token):
            yield "section", section[1]
            doc = []
        elif token.startswith("///"):
            doc.append(text_of(token))
        elif token.endswith("{"):
            kind, name, base = re.match(r"(\w+)\s+(\w+)\s*:?\s*(\w*)", token).groups()
            end = text.index("}", at)
            yield kind, name, base, text[at:end], " ".join(doc)
            at, doc = end + 1, []


def heading(text):
    """The comment that opens a file, as it stands."""
    return [line[2:].removeprefix(" ") for line in re.match(r"(?://(?!/)[^\n]*\n)*", text).group().splitlines()]


def reference():
    out = [""]
    for name, title in TITLES.items():
        text = (FOLDER / f"{name}.fbs").read_text()
        out += [f"## {title}: `{name}.fbs`", ""]
        opening = heading(text)
        prose = [line for line in opening if not line.startswith("  ")]
        first = next((i for i, line in enumerate(opening) if line.startswith("  ")), len(opening))
        block = [line for line in opening[first:] if line.startswith("  ")]
        out += [escaped(line) for line in opening[:first]] + [""]
        if block:
            out += ["```", *(line[2:] for line in block), "```", ""]
            out += [escaped(line) for line in prose[first:]] + [""]
        for declared in declarations(text[len("\n".join(opening)):]):
            if declared[0] == "section":
                out += [f"### {declared[1]}", ""]
                continue
            kind, what, base, body, doc = declared
            out += [f"#### {what}" + (f" ({kind}{' of ' + base if base else ''})" if kind != "table" else ""), ""]
            if doc:
                out += [escaped(doc), ""]
            if kind in ("enum", "union"):
                out += [", ".join(f"`{each.strip()}`" for each in body.split(",")), ""]
            elif rows := fields(body):
                out += ["| field | type | |", "|---|---|---|"]
                out += [f"| {field} | {type_} | {escaped(said)} |" for field, type_, said in rows] + [""]
    return "\n".join(out).rstrip() + "\n"


if __name__ == "__main__":
    target = FOLDER / "README.md"
    text = target.read_text()
    by_hand, mark, _ = text.partition(MARK + "\n")
    if not mark:
        sys.exit(f"schema/README.md lacks the line that its reference stands below: {MARK}")
    page = by_hand + mark + reference()
    if "--check" not in sys.argv[1:]:
        target.write_text(page)
    elif text != page:
        sys.exit("schema/README.md is not what the schema files say: python schema/reference.py writes it")
