"""Whether clients carry what the schema has: the structs and functions of C, C# and Python are written by hand beside
schema/message.fbs. (C++, TypeScript and the readers of recordings have code that flatc makes.)

    python tests/clients/mirrors_test.py [SCHEMA]

Each field of a message that a client sends or receives must be in a struct or an argument of its functions, under its name in
the spelling of the language, with a type that fits, or in NOT_CARRIED with the reason. The structs of C# must be laid out as
those of C. SCHEMA: another folder than schema/.
"""

import ast
import pathlib
import re
import sys

root = pathlib.Path(__file__).resolve().parents[2]
schema = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else root / "schema"
sys.path.insert(0, str(root / "schema"))
from reference import declarations, fields  # noqa: E402

# Where clients have each message: structs begin with a capital letter, functions do not. `spawn` is crumple_spawn in C and Spawn in C#.
CARRIED = {
    "Pose": ["Pose"],
    "CarPose": ["CarPose"], "Poses": ["publish_poses"], "Obstacle": ["Obstacle"], "Obstacles": ["publish_obstacles"],
    "Spawn": ["spawn", "Spawn"], "Despawn": ["despawn"], "Repair": ["repair"], "Parameters": ["Parameters"], "Save": ["save"],
    "Load": ["load"], "Answer": ["Answer"], "Reactions": ["Reaction"], "Reaction": ["Reaction"], "Partner": ["Partner"], "Keyframe": ["Surface"],
    "Delta": ["Surface"], "Health": ["Health"],
}
NOT_CARRIED = {
    "Vec3": "three numbers", "Vec3d": "three numbers", "Quat": "four numbers",
    "Poses.sequence": "the session counts", "Obstacles.sequence": "the session counts",
    "Spawn.host": "the session's, from when it was opened",
    "Command": "each order has a function of its own",
    "Asset": "only the gateway gives a server more cars", "Replace": "only the page paints cars anew",
    "State": "Save and Load carry it as bytes",
    "Reactions.cars": "each is a Reaction, which has the tick and time of its message",
    "Keyframe.first": "the session puts parts together", "Delta.first": "the session puts parts together",
    "Keyframe.count": "the session puts parts together", "Delta.count": "the session puts parts together",
    "Keyframe.packed": "Surface.quanta", "Delta.packed": "Surface.quanta",
    "Delta.keyframe": "the session knows which keyframe it holds",
    "Python Keyframe.node_count": "len(Surface.quanta)", "Python Delta.node_count": "len(Surface.quanta)",
    "Python Answer": "functions return its tick or state, or raise Refused with its sentence",
    "Health.rooms": "Health.tick_ms and worst_ms are those of the whole tick", "Room": "part of Health.rooms",
    "Health.refusals": "their sum", "Health.counts": "for those who run a server", "Count": "part of these two",
    "Health.told": "the session asks for what it lost", "CarTold": "part of Health.told",
    "Budget": "only in recordings", "TickEnd": "only in recordings",
    "Input": "only for servers that stand by", "Inputs": "only for servers that stand by",
    "C Solver": "an int, where -1 keeps the solver",
}
# Types in C, C# and Python that match a type of the schema.
FITTING = {
    "bool": ("int", "bool|int", "bool"), "byte": ("int", "int", "int"), "ushort": ("uint32_t", "uint", "int"),
    "uint": ("uint32_t", "uint", "int"), "ulong": ("uint64_t", "ulong", "int"), "float": ("float", "float", "float"),
    "double": ("double", "double", "float"), "string": ("const char*", "string|IntPtr", "str"),
    "Vec3": ("float[3]", "Float3", "Vector"), "[Vec3]": ("const float*", "IntPtr", "tuple[Vector, ...]"),
    "Vec3d": ("double[3]", "Double3", "Vector"), "Quat": ("float[4]", "Rotation", "Vector"),
    "[ubyte]": ("const uint8_t*|const void*", "IntPtr|byte[]", "bytes"),
    "Pose": ("CrumplePose", "Pose", "Pose"), "Shape": ("int", "Shape", "Shape"), "Solver": ("int", "Solver", "Solver"),
    "[Partner]": ("const CrumplePartner*", "IntPtr", "tuple[Partner, ...]"),
    "[CarPose]": ("const CrumpleCarPose*", "CarPose[]", "Sequence[CarPose]"),
    "[Obstacle]": ("const CrumpleObstacle*", "Obstacle[]", "Sequence[Obstacle]"),
}


def snake(name):
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower().rstrip("_")


def declared(text):
    """Returns names with types of `float a[3], b;` or `const char* car`."""
    found = re.fullmatch(r"(.*?[\w\]>]\**)\s+(\w+(?:\[\d+\])?(?:, \w+(?:\[\d+\])?)*)", text.strip())
    names = [re.fullmatch(r"(\w+)(.*)", name).groups() for name in found[2].split(", ")] if found else []
    return {snake(name): found[1] + size for name, size in names}


def in_c():
    text = re.sub(r"//.*", "", (root / "clients/cpp/include/crumple_client.h").read_text())
    enums = {name: [snake(each.split("_", 1)[1]) for each in re.findall(r"\w+", body)]
             for name, body in re.findall(r"enum Crumple(\w+) \{([^}=]*)\}", text)}
    found = {name: {field: type_ for line in body.split(";") for field, type_ in declared(line).items()}
             for name, body in re.findall(r"typedef struct Crumple(\w+) \{(.*?)\}", text, re.DOTALL)}
    for name, arguments in re.findall(r"crumple_(\w+)\(([^)]*)\);", text):
        found[name] = {field: type_ for each in arguments.split(",") for field, type_ in declared(each).items()}
    return found, enums


def in_c_sharp():
    text = re.sub(r"//.*", "", (root / "clients/unity/Crumple.cs").read_text())
    enums = {name: [snake(each) for each in re.findall(r"\w+", re.sub(r"\w+ = -1", "", body))]
             for name, body in re.findall(r"enum (\w+) \{([^}]*)\}", text)}
    found = {}
    for name, body in re.findall(r"^(?:public )?struct (\w+) \{(.*?)^\}", text, re.DOTALL | re.MULTILINE):
        lines = re.findall(r"^  (?:public |internal )?([\w\[\]]+ [\w, ]+);", body, re.MULTILINE)
        found[name] = {field: type_ for line in lines for field, type_ in declared(line).items()}
    for name, arguments in re.findall(r"^  public (?:\w+|byte\[\]) (\w+)\(((?:[^()]|\(\w+\))*)\) \{", text, re.MULTILINE):
        given = [re.sub(r" = .*", "", each) for each in arguments.split(",")]
        found[snake(name)] = {field: type_ for each in given for field, type_ in declared(each).items()}
    return found, enums


def in_python():
    found, enums = {}, {}
    for name in ("types", "session"):
        for node in ast.walk(ast.parse((root / f"clients/python/src/crumple/{name}.py").read_text())):
            if isinstance(node, ast.ClassDef) and any(ast.unparse(base) == "enum.IntEnum" for base in node.bases):
                enums[node.name] = [each.targets[0].id for each in node.body if isinstance(each, ast.Assign)]
            elif isinstance(node, ast.ClassDef):
                given = [(each.target.id, each.annotation) for each in node.body if isinstance(each, ast.AnnAssign)]
            elif isinstance(node, ast.FunctionDef):
                given = [(each.arg, each.annotation) for each in node.args.args + node.args.kwonlyargs if each.annotation]
            else:
                continue
            if node.name not in enums:
                found[node.name] = {snake(field): ast.unparse(type_).removesuffix(" | None") for field, type_ in given}
    return found, enums


wrong, used = [], set()


def excused(language, name):
    reasons = {name, f"{language} {name}"} & NOT_CARRIED.keys()
    used.update(reasons)
    return bool(reasons)


def check(language, column, found, enums):
    for kind, name, _, body, _ in messages:
        if kind == "union" or excused(language, name):
            continue
        if kind == "enum":
            wanted = [each.strip() for each in body.split(",")]
            if enums.get(name) != wanted:
                wrong.append(f"{language}: {name} is {enums.get(name)}, in the schema {wanted}")
            continue
        carriers = [found[each] for each in CARRIED.get(name, []) if each in found]
        if not carriers:
            wrong.append(f"{language}: nothing carries {name}; NOT_CARRIED may say why")
        for field, type_, _ in fields(body):
            field, type_ = field.strip("`"), re.match(r"`([\w\[\]]+)", type_)[1]
            if not carriers or excused(language, f"{name}.{field}"):
                continue
            types = [each[field] for each in carriers if field in each]
            if not types:
                where = " or ".join(CARRIED[name])
                wrong.append(f"{language}: {name}.{field}, {type_}, is not carried by {where}; NOT_CARRIED may say why")
            elif type_ not in FITTING or any(each not in FITTING[type_][column].split("|") for each in types):
                wrong.append(f"{language}: {name}.{field} is {' and '.join(types)}, which FITTING has not for {type_}")


# C# passes its structs without conversion.
def check_layout(c, c_sharp):
    fits = {"uint64_t": "ulong", "uint32_t": "uint", "int": "int|Shape|Solver", "size_t": "UIntPtr", "float[3]": "Float3",
            "double[3]": "Double3", "float[4]": "Rotation", "CrumplePose": "Pose"}
    for name, theirs in c.items():
        ours = c_sharp.get(name, {})
        if not name[0].isupper():
            continue
        same = list(theirs) == list(ours) and all(
            ours[field] in fits.get(type_, "IntPtr" if "*" in type_ else type_).split("|") for field, type_ in theirs.items())
        if not same:
            wrong.append(f"C#: {name} is laid out as {ours}, in C as {theirs}")


texts = [(schema / f"{name}.fbs").read_text() for name in ("geometry", "message")]
messages = [each for text in texts for each in declarations(text) if each[0] != "section"]
languages = {"C": in_c(), "C#": in_c_sharp(), "Python": in_python()}
for column, (language, (found, enums)) in enumerate(languages.items()):
    check(language, column, found, enums)
check_layout(languages["C"][0], languages["C#"][0])
wrong += [f"NOT_CARRIED: {name} is not in the schema any more" for name in NOT_CARRIED.keys() - used]
print("\n".join(wrong) or f"{len(messages)} messages and shapes, {len(languages)} languages: all is carried")
sys.exit(bool(wrong))
