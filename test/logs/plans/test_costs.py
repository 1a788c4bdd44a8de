"""What a plan costs that is made to cost much: memory, whatever its format."""

import gzip
import json
import subprocess
import sys

MEASURED = """
import json, resource, sys
from evpinn_ros.common.errors import InputError
from evpinn_ros.logs.plans import read_plan
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
read_plan(sys.argv[1])
begin, said = peak(), {}
for path in sys.argv[2:]:
    try:
        read_plan(path)
    except InputError as error:
        said[path.rpartition("/")[2]] = str(error)
print(json.dumps([peak() - begin, said]))
"""


def test_no_plan_takes_more_memory_than_a_long_trip(tmp_path):
    """Each of them took 200 to 1300 MB; the file itself is up to 32 MB."""
    wide = "t_s,speed_mps,distance_m" + ",a" * 2000 + "\n"
    rows = b"1,1,1" + b"," * 2000 + b"\n"
    plans = {
        "good.csv": b"t_s,speed_mps\n0,9\n9,9\n90,9\n",
        "values.json": b'{"type":"x","a":[' + b"[]," * 5_000_000 + b"[]]}",
        "deep.gpx": b"<gpx>" + b"<a>" * 9_000_000,
        "empty.gpx": b"<gpx>" + b"<trkpt/>" * 3_000_000 + b"</gpx>",
        "points.gpx": b"<gpx>" + b'<trkpt lat="1" lon="2"/>' * 1_000_000 + b"</gpx>",
        "wide.csv.gz": gzip.compress(wide.encode() + rows * 6000, 9),
    }
    for name, content in plans.items():
        (tmp_path / name).write_bytes(content)
    command = [sys.executable, "-c", MEASURED, *(str(tmp_path / name) for name in plans)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    megabytes, said = json.loads(done.stdout)
    assert "more than 1000000 values" in said["values.json"]
    assert "more than 100 elements deep" in said["deep.gpx"]
    assert "more than 100000 points" in said["points.gpx"]
    assert {"empty.gpx", "wide.csv.gz"} <= said.keys()
    assert megabytes < 150.0
