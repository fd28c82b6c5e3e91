"""Metrics, dashboard, alerts and documentation say the same names; and every query of the dashboard shows something when Prometheus reads a
server that is busy with everything that is measured.

usage: figures.py, for the names alone
"""

import json
import re
import struct
import subprocess
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent.parent
DASHBOARD = ROOT / "docker/grafana/dashboards/ubbmap.json"
ALERTS = ROOT / "docker/prometheus/alerts.yml"
PROMETHEUS = "http://127.0.0.1:9090"
MAP = "/v1/maps/figures"
BOX = "min_x=-2&min_y=-2&max_x=6&max_y=5"

# Metrics of servers with TLS or tokens, which the one that is looked at has not: neither shown by it nor to be drawn.
ELSEWHERE = {"ubbmap_reloads_total", "ubbmap_tls_certificate_expiry_seconds", "ubbmap_tls_handshakes_total"}

# Rates need two scrapes, and rates over what begins with the first of them a third.
SCRAPES = 4


def metric_names(text):
    """Names without the endings that Prometheus gives a histogram's parts."""
    return {re.sub(r"_(bucket|sum|count)$", "", name) for name in re.findall(r"\bubbmap_[a-z_]+", text)}


def expressions(dashboard):
    """(title, query, legend) of every panel."""
    panels = [panel for panel in dashboard["panels"] if panel["type"] != "row"]
    return [(panel["title"], target["expr"], target["legendFormat"]) for panel in panels for target in panel["targets"]]


def names_agree(served=None):
    """Every metric is in the source, the documentation and the dashboard, and no other is; `served` are those of a server."""
    sources = [*(ROOT / "src/reload").glob("*.rs"), *(ROOT / "src/service").glob("*.rs"), *(ROOT / "src/transport").rglob("*.rs")]
    known = {name for path in sources for name in re.findall(r'^(?:pub\S* )?const \w+: &str = "(ubbmap_\w+)";', path.read_text(), re.M)}
    assert len(known) > 20, f"only {known} found: the check no longer sees the metrics"
    table = set(re.findall(r"^\| `(ubbmap_\w+)`", (ROOT / "docs/operations.md").read_text(), re.M))
    dashboard = json.loads(DASHBOARD.read_text())
    drawn = metric_names(" ".join(query for _, query, _ in expressions(dashboard)))
    watched = metric_names(" ".join(rule["expr"] for group in yaml.safe_load(ALERTS.read_text())["groups"] for rule in group["rules"]))
    differences = {
        "not in the table of docs/operations.md": known - table,
        "in the table, but no metric": table - known,
        "not on the dashboard": known - drawn,
        "on the dashboard, but no metric": drawn - known,
        "in the alerts, but no metric": watched - known,
    }
    if served is not None:
        differences["not shown by a busy server"] = known - served - ELSEWHERE
        differences["shown by a server, but not known here"] = served - known
    differences = {what: sorted(names) for what, names in differences.items() if names}
    assert not differences, differences


def dashboard_is_sound():
    """What Grafana would complain about late or not at all."""
    dashboard = json.loads(DASHBOARD.read_text())
    panels = dashboard["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels), "ids of panels are not unique"
    source = yaml.safe_load((ROOT / "docker/grafana/provisioning/datasources/prometheus.yml").read_text())["datasources"][0]
    taken = {}
    for panel in panels:
        place = panel["gridPos"]
        assert place["x"] + place["w"] <= 24, panel["title"]
        for cell in ((x, y) for x in range(place["x"], place["x"] + place["w"]) for y in range(place["y"], place["y"] + place["h"])):
            assert cell not in taken, f"{panel['title']} lies on {taken[cell]}"
            taken[cell] = panel["title"]
        for target in panel.get("targets", []):
            assert target["datasource"]["uid"] == panel["datasource"]["uid"] == source["uid"], panel["title"]
            assert 'instance=~"$instance"' in target["expr"], panel["title"]
    config = yaml.safe_load((ROOT / "docker/prometheus/prometheus.yml").read_text())
    assert source["jsonData"]["timeInterval"] == config["global"]["scrape_interval"]
    provider = yaml.safe_load((ROOT / "docker/grafana/provisioning/dashboards/ubbmap.yml").read_text())["providers"][0]
    grafana = yaml.safe_load((ROOT / "docker/compose.yaml").read_text())["services"]["grafana"]
    assert f"./grafana/dashboards:{provider['options']['path']}:ro" in grafana["volumes"]
    assert grafana["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"] == f"{provider['options']['path']}/{DASHBOARD.name}"


def refused(url):
    """The code of the problem that a request is answered with."""
    try:
        get(url)
    except urllib.error.HTTPError as error:
        return json.load(error)["code"]
    raise AssertionError(f"{url} was answered")


def get(url, data=None, kind="application/json"):
    request = urllib.request.Request(url, data, {"Content-Type": kind})
    with urllib.request.urlopen(request, timeout=20) as answer:
        return answer.read()


class Load:
    """Everything that is measured, once in a round, until it is stopped."""

    def __init__(self, server):
        import zenoh

        self.server, self.sequence, self.failure = server, 0, None
        self.scan = json.loads((ROOT / "examples/scan.json").read_text())
        # A beam that failed, for its counter.
        self.scan["ranges"][0] = "NaN"
        config = zenoh.Config.from_json5('{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:7447"]}, scouting: {multicast: {enabled: false}}}')
        self.zenoh = zenoh.open(config)
        request = urllib.request.Request(server + MAP, json.dumps({"resolution": 0.05}).encode(), {"Content-Type": "application/json"}, method="PUT")
        urllib.request.urlopen(request, timeout=20).read()
        self.watch = urllib.request.urlopen(server + MAP + "/events", timeout=20)
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self):
        try:
            while not self.stopped.wait(0.2):
                self.round()
        except Exception as failure:
            self.failure = failure

    def round(self):
        self.sequence += 1
        scans = [{**self.scan, "sequence": number} for number in (self.sequence, max(1, self.sequence - 1))]
        wide = {**self.scan, "pose": {**self.scan["pose"], "x": {"min": 0, "max": 99}}}
        get(self.server + MAP + "/scans", json.dumps({"scans": [*scans, wide]}).encode())
        region = {"box": {"min_x": 1, "min_y": 1, "max_x": 2, "max_y": 2}}
        get(self.server + MAP + "/guaranteed-free", json.dumps({"regions": [region]}).encode())
        get(self.server + MAP + "/classes", json.dumps({"points": [{"x": 1, "y": 1}]}).encode())
        get(f"{self.server}{MAP}/region?{BOX}&depth=14")
        get(f"{self.server}{MAP}/grid?{BOX}&depth=14&format=npy")
        # More cells than limits.cells_per_answer.
        assert refused(f"{self.server}{MAP}/grid") == "REGION_TOO_LARGE"
        get(f"{self.server}{MAP}/changes?since=0")
        get(f"{self.server}{MAP}/tiles/2/1/1.png")
        get(f"{self.server}{MAP}/export?format=ubbmap")
        # gRPC-Web: ListMaps with an empty message.
        get(self.server + "/ubbmap.v1.MapService/ListMaps", struct.pack(">BI", 0, 0), "application/grpc-web+proto")
        # InsertScansRequest{scans: [{sequence: n}]}, every other number left out; refused, since it has no pose.
        number = 2 * self.sequence % 128
        self.zenoh.put("ubbmap/figures/scans/robot", bytes([0x12, 2, 0x10, number]))

    def stop(self):
        self.stopped.set()
        self.thread.join()
        self.watch.close()
        self.zenoh.close()
        assert self.failure is None, self.failure


def ask(query):
    """The samples of a query, as (labels, value)."""
    url = f"{PROMETHEUS}/api/v1/query?{urllib.parse.urlencode({'query': query})}"
    answer = json.loads(get(url))
    return [(sample["metric"], float(sample["value"][1])) for sample in answer["data"]["result"]]


def filled(query):
    """A query as Grafana sends it, over a range of three scrapes."""
    return query.replace("$__rate_interval", "15s").replace("$instance", ".*")


def look(program, work, server):
    """Has Prometheus read the server under load with the configuration of docker/prometheus as it is, and asks all that the dashboard asks."""
    # The names that the network of compose.yaml has.
    hosts = work / "hosts"
    hosts.write_text("127.0.0.1 localhost ubbmap prometheus\n")
    subprocess.run(["mount", "--bind", hosts, "/etc/hosts"], check=True)
    load = Load(server)
    arguments = [f"--config.file={ROOT}/docker/prometheus/prometheus.yml", f"--storage.tsdb.path={work}/figures", "--web.listen-address=127.0.0.1:9090"]
    with open(work / "prometheus.log", "w") as log:
        prometheus = subprocess.Popen([program, *arguments], stdout=log, stderr=log)
    try:
        for _ in range(120):
            time.sleep(0.5)
            assert prometheus.poll() is None and load.failure is None, (work / "prometheus.log").read_text() + str(load.failure)
            try:
                scraped = ask('count_over_time(up{job="ubbmap"}[10m])')
            except OSError:
                continue
            if scraped and scraped[0][1] >= SCRAPES:
                break
        assert ask('up{job="ubbmap"}')[0][1] == 1, "Prometheus does not reach the server"
        names_agree(metric_names(re.sub(r"^#.*$", "", get(server + "/metrics").decode(), flags=re.M)))
        empty = [panel for panel in expressions(json.loads(DASHBOARD.read_text())) if not metric_names(panel[1]) <= ELSEWHERE]
        # Where the machine is busy a scrape comes late, and a rate has nothing to compare for a while.
        for _ in range(60):
            empty = [panel for panel in empty if not is_drawn(*panel[1:])]
            if not empty or load.failure:
                break
            time.sleep(0.5)
        assert not empty, f"panels that show nothing: {empty}"
        rules = [rule for group in json.loads(get(PROMETHEUS + "/api/v1/rules"))["data"]["groups"] for rule in group["rules"]]
        assert rules and all(rule["health"] == "ok" for rule in rules), rules
        firing = {rule["name"] for rule in rules if rule["state"] == "firing"}
        assert not firing, f"alerts fire on a server that is well: {firing}"
    finally:
        prometheus.terminate()
        load.stop()
        prometheus.wait(30)
    print("figures: every metric is shown, documented and drawn; every query of the dashboard has an answer; no alert fires")


def is_drawn(query, legend):
    """Has the query a number, and every line the labels that its legend names?"""
    samples = ask(filled(query))
    named = set(re.findall(r"{{(\w+)}}", legend))
    return any(value == value for _, value in samples) and all(named <= set(labels) for labels, _ in samples)


if __name__ == "__main__":
    names_agree()
    dashboard_is_sound()
    print("figures: metrics, documentation, dashboard and alerts name the same")
