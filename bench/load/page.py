"""Writes the page of bench/load/run: the results of its runs in tables and pictures.

    page.py FOLDER     reads FOLDER/*/load.json, writes FOLDER/page.md, load.png and knee.png
"""

import json
import pathlib
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

KNEES = {
    "all": ("5,000 nodes, all sweeps", "#D55E00"),
    "budget": ("5,000 nodes, within the budget", "#0072B2"),
    "levels": ("5,000, 1,000 or 300 nodes, within the budget", "#009E73"),
}
PERIOD = 1e3 / 60  # ms


def rows(run):
    """Returns the table's entries for one run: label, text."""
    yield "cars: crash at once, drive, sleep", f"{run['crashing']:.0f}, {run['driving']:.0f}, {run['asleep']:.0f}"
    yield "server's options", f"`{run['serve']}`" if run["serve"] else "none"
    yield "ticks; late ticks", f"{run['ticks']:.0f}; {run['late']:.0f}"
    yield "longest tick", f"{run['worst_tick_ms']:.1f} ms"
    yield "time from tick to tick p50, p99, p99.9", f"{run['interval_ms_p50']:.1f}, {run['interval_ms_p99']:.1f}, {run['interval_ms_p99.9']:.1f} ms"
    yield "delay from a tick to its surface at the viewer p50, p99, p99.9", f"{run['latency_ms_p50']:.2f}, {run['latency_ms_p99']:.2f}, {run['latency_ms_p99.9']:.2f} ms"
    yield "surfaces that came; that never came", f"{run['surfaces']:.0f}; {run['surfaces_missing']:.0f}"
    yield f"viewer of {run['follow']:.0f} cars: mean, busiest second", f"{run['viewer_mbits_mean']:.2f}, {run['viewer_mbits_worst']:.2f} Mb/s"
    if run["far_viewer_mbits_mean"] > 0:
        yield "far viewer of every car: mean, busiest second", f"{run['far_viewer_mbits_mean']:.2f}, {run['far_viewer_mbits_worst']:.2f} Mb/s"
    yield "bits per vertex and frame; for far viewers", f"{run['bits_per_vertex_frame']:.1f}; {run['far_bits_per_vertex_frame']:.1f}"
    yield "time to the first surfaces; for late viewers", f"{run['open_ms_worst']:.0f}; {run['late_join_ms_worst']:.0f} ms"
    if run["thawed_current_after_ms"] > 0:
        stale = f"{run['thawed_stale_ms_worst']:.0f} ms"
        yield "viewer frozen for 3 s: up to date again after; its surfaces were out of date by at most", f"{run['thawed_current_after_ms']:.0f} ms; {stale}"
    yield "surfaces that differ at the end", f"{run['diverged']:.0f} of {run['compared']:.0f}"
    yield "processor time of the server; of its recorder", f"{run['cpu_cores']:.2f}; {run['recorder_cores']:.3f} cores"
    yield "memory; file descriptors", f"{run['memory_mb']:.0f} MB; {run['descriptors_most']:.0f}"
    yield "worst residual of a sub-step", f"{run['residual_worst_mm']:.2f} mm"
    yield "messages that the recording lost; that the network dropped", f"{run['recording_lost']:.0f}; {run['sent_dropped'] + run['received_dropped']:.0f}"


def draw_runs(runs, path):
    figure, axes = plt.subplots(len(runs), 3, figsize=(12, 3.2 * len(runs)), squeeze=False, layout="constrained")
    for (name, run), (rooms, delay, memory) in zip(runs.items(), axes):
        time = [row[0] for row in run["rooms"]]
        rooms.plot(time, [row[8] for row in run["rooms"]], color="#D55E00", label="longest tick of the second")
        rooms.plot(time, [row[7] for row in run["rooms"]], color="#0072B2", label="mean tick")
        rooms.axhline(PERIOD, color="grey", linestyle=":", label="a tick's time")
        rooms.set(title=f"{name}: ticks, ms", xlabel="s", yscale="log")
        rooms.legend(fontsize=7, loc="upper right")
        rooms.set_ylim(top=20 * max(row[8] for row in run["rooms"]))
        share = [100 * row[0] for row in run["quantiles"]]
        delay.plot([row[2] for row in run["quantiles"]], share, color="#009E73")
        delay.set(title=f"{name}: surface at the viewer after its tick", xlabel="ms", ylabel="% within", xscale="log")
        delay.set_xlim(left=0.1)
        memory.plot([row[0] for row in run["samples"]], [row[2] for row in run["samples"]], color="#CC79A7")
        memory.set(title=f"{name}: memory of the server, MB", xlabel="s")
        memory.set_ylim(0, 1.2 * max(row[2] for row in run["samples"]))
    figure.savefig(path, dpi=90)
    plt.close(figure)


def draw_knees(knees, path):
    figure, (late, longest, delay) = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    for kind, (label, colour) in KNEES.items():
        runs = sorted(knees.get(kind, []), key=lambda run: run["crashing"])
        cars = [run["crashing"] for run in runs]
        late.plot(cars, [100 * run["late"] / max(1, run["ticks"]) for run in runs], "o-", color=colour, label=label)
        longest.plot(cars, [run["worst_tick_ms"] for run in runs], "o-", color=colour)
        delay.plot(cars, [run["latency_ms_p99"] for run in runs], "o-", color=colour)
    longest.axhline(PERIOD, color="grey", linestyle=":")
    for axis, title in ((late, "late ticks, %"), (longest, "longest tick, ms"), (delay, "surface after its tick, p99, ms")):
        axis.set(title=title, xlabel="cars that crash at once", xscale="log")
        counts = [2**k for k in range(8)]
        axis.set_xticks(counts, counts)
        axis.minorticks_off()
    for axis in (longest, delay):
        axis.set_yscale("log")
    figure.legend(*late.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def link_rows(links):
    """Returns the table of impaired links: its head, then a row for each link."""
    yield "| link, one way | delay of a surface p50, p99, ms | longest delay, ms | up to date after a cut of 2 s, ms | first surface; of a late viewer, ms | keyframes asked for | mean Mb/s | packets lost | differ at the end |"
    yield "|---" * 9 + "|"
    for run in links:
        parts = ["QUIC" if run["link"] == "udp" else "TCP"]
        if run["loss"]:
            parts.append(f"{100 * run['loss']:.0f} %")
        parts.append(f"{run['delay_ms']:.0f}" + (f" +- {run['jitter_ms']:.0f}" if run["jitter_ms"] else "") + " ms")
        if run["reorder"]:
            parts.append(f"{100 * run['reorder']:.0f} % overtake")
        if run["kbit"]:
            parts.append(f"{run['kbit']:.0f} kbit/s")
        yield (
            f"| {', '.join(parts)} | {run['latency_ms_p50']:.0f}, {run['latency_ms_p99']:.0f} | {run['latency_ms_most']:.0f} | {run['back_ms_worst']:.0f} "
            f"| {run['open_ms_worst']:.0f}; {run['late_join_ms_worst']:.0f} | {run['keyframes_asked']:.0f} | {run['viewer_mbits_mean']:.2f} "
            f"| {run['packets_lost']:.0f} of {run['packets']:.0f} | {run['diverged']:.0f} of {run['compared']:.0f} |"
        )


def main(folder):
    runs, knees, links = {}, {}, []
    for file in sorted(folder.glob("*/load.json")):
        run, name = json.loads(file.read_text()), file.parent.name
        if name.startswith("knee-"):
            knees.setdefault(name.split("-")[1], []).append(run)
        elif name.startswith("link-"):
            links.append(run)
        elif name in ("ten", "hundred"):
            runs[name] = run
    if not runs and not links:
        sys.exit(f"page.py: {folder} has no run of bench/load/run; start bench/load/run first")
    runs = dict(sorted(runs.items(), key=lambda item: item[1]["crashing"]))
    text = ["# The server under load", ""]
    text += [f"`bench/load/run` measured this on one machine ({[*runs.values(), *links][0]['machine']}), which the server, the hosts and the viewers share.", "All messages cross zenoh over TCP on loopback. The server records.", ""]
    if runs:
        tables = [dict(rows(run)) for run in runs.values()]
        labels = list(dict.fromkeys(label for table in tables for label in table))
        text += ["| | " + " | ".join(f"`{name}.toml`" for name in runs) + " |", "|---" * (len(runs) + 1) + "|"]
        text += [f"| {label} | " + " | ".join(table.get(label, "") for table in tables) + " |" for label in labels]
        draw_runs(runs, folder / "load.png")
        text += ["", "![Ticks, delay and memory](load.png)", ""]
    if knees:
        draw_knees(knees, folder / "knee.png")
        text += ["## Where it breaks", "", "Every three seconds cars hit walls at 50 km/h, all in the same tick; from run to run there are more of them. There are four viewers.", "", "![Late ticks, longest tick and delay against cars that crash at once](knee.png)", ""]
        text += ["| cars at once | late of all ticks | longest tick, ms | delay of a surface p50, p99, ms | worst residual, mm |", "|---|---|---|---|---|"]
        for kind, (label, _) in KNEES.items():
            for run in sorted(knees.get(kind, []), key=lambda each: each["crashing"]):
                text.append(
                    f"| {run['crashing']:.0f} x {label} | {run['late']:.0f} of {run['ticks']:.0f} | {run['worst_tick_ms']:.1f} "
                    f"| {run['latency_ms_p50']:.2f}, {run['latency_ms_p99']:.2f} | {run['residual_worst_mm']:.2f} |"
                )
    if links:
        text += ["", "## Bad links", "", "Five cars hit walls every three seconds. Three viewers, and a fourth that comes late, each have a link that delays and loses packets in both", "directions alike (`bench/impaired_link.h`). TCP sends lost packets again, and the later data waits for them. QUIC means `udp/HOST:PORT?rel=1`.", ""]
        text += link_rows(links)
    (folder / "page.md").write_text("\n".join(text) + "\n")
    print(f"written {folder}/page.md")


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] in ("-h", "--help"):
        sys.exit(__doc__)
    main(pathlib.Path(sys.argv[1]))
