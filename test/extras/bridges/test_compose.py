"""The compose file beside TeslaMate's: what it starts is a command that exists."""

from pathlib import Path
import re

from typer.main import get_command
import yaml

from evpinn_ros.cli.main import app

FILE = Path(__file__).resolve().parents[3] / "config" / "docker" / "evpinn-mqtt.yml"


def test_its_command_is_one_that_the_command_line_takes():
    service = yaml.safe_load(FILE.read_text())["services"]["evpinn"]
    words = [re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", word) for word in service["command"]]
    command = get_command(app)
    below = command.get_command(command.make_context("evpinn", words), words[0])
    given = below.make_context("mqtt", words[1:]).params
    assert (given["broker"], given["vehicle"]) == ("mosquitto", "tesla_model_3_lr")
    volume, _, path = service["volumes"][0].partition(":")
    assert str(given["state"]) == path and volume in yaml.safe_load(FILE.read_text())["volumes"]
    assert "PASSWORD" not in " ".join(words), "ps would show it"
