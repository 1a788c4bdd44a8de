"""The compose file beside TeslaMate's: what it starts is a command that exists."""

from pathlib import Path
import re

from typer.main import get_command
import yaml

from evpinn_ros.cli.main import app

FILE = Path(__file__).resolve().parents[3] / "config" / "docker" / "evpinn-mqtt.yml"


def test_its_command_is_one_that_the_command_line_takes() -> None:
    service = yaml.safe_load(FILE.read_text())["services"]["evpinn"]
    words = [re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", word) for word in service["command"]]
    command = get_command(app)
    below = command.get_command(command.make_context("evpinn", words), words[0])
    given = below.make_context("mqtt", words[1:]).params
    assert (given["broker"], given["vehicle"]) == ("mosquitto", "tesla_model_3_lr")
    volume, _, path = service["volumes"][0].partition(":")
    assert str(given["state"]) == path and volume in yaml.safe_load(FILE.read_text())["volumes"]
    assert "PASSWORD" not in " ".join(words), "ps would show it"


def test_an_owner_who_types_the_guide_sets_what_it_reads() -> None:
    """By `.env`, so that the `docker compose logs` of the next line knows the service."""
    guide = (FILE.parents[2] / "docs" / "guides" / "teslamate.md").read_text()
    set_there = dict(re.findall(r'echo "(\w+)=(.*)" >> \.env', guide))
    assert set_there["COMPOSE_FILE"] == f"docker-compose.yml:{FILE.name}"
    read = set(re.findall(r"\$\{(\w+)", FILE.read_text()))
    assert set(set_there) - {"COMPOSE_FILE"} <= read
    assert all(name in guide for name in read)
