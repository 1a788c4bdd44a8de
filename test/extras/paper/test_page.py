"""The page of `evpinn reproduce` in a real Chromium."""

import numpy as np
import pytest

from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.paper.drive_log import DriveLog
from evpinn_ros.extras.paper.experiment import Experiment, Settings
from evpinn_ros.extras.paper.optimizer_name import OptimizerName
from evpinn_ros.extras.paper.page import write_reproduction

pytestmark = pytest.mark.torch

SHOWN = """Array.from(document.querySelectorAll('img'))
  .filter(image => image.offsetParent !== null && image.naturalWidth > 500)
  .map(image => image.className)"""
CUT = """Array.from(document.querySelectorAll('table, img'))
  .filter(each => each.getBoundingClientRect().right > innerWidth).length"""
SHADES = """Array.from(document.querySelectorAll('img'))
  .filter(image => image.offsetParent !== null)
  .map(image => {
    const copy = new OffscreenCanvas(image.naturalWidth, image.naturalHeight).getContext('2d');
    copy.drawImage(image, 0, 0);
    const { data } = copy.getImageData(0, 0, image.naturalWidth, image.naturalHeight);
    const seen = [];
    for (let i = 0; i < data.length; i += 4)
      if (data[i + 3] > 250) seen.push((data[i] + data[i + 1] + data[i + 2]) / 3);
    return [data[3], Math.min(...seen.slice(0, 50000)), Math.max(...seen.slice(0, 50000))];
  })"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    time = 0.1 * np.arange(400)
    speed = np.maximum(12.0 + 9.0 * np.sin(0.45 * time) + 6.0 * np.sin(1.1 * time), 0.0)
    acceleration = np.gradient(speed, 0.1)
    power = 900.0 + speed * (180.0 + 2400.0 * acceleration + 0.4 * speed**2)
    folder, car = tmp_path_factory.mktemp("reproduce"), load_vehicle("tesla_model_3_lr")
    settings = Settings(OptimizerName.GAUSS_NEWTON, epochs=12, energy_epochs=5)
    log = DriveLog(time, speed, acceleration, power)
    outcome = Experiment(log, car, settings, folder).run(lambda *_: None)
    write_reproduction(folder / "report.html", outcome, "evpinn reproduce x", "QUICK LOOK")
    return folder / "report.html"


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1100, 500])
def test_nothing_is_cut_off_and_letters_stand_out(browser, page, width, dark):
    browser.open(page, width=width, dark=dark)
    assert browser.run("document.querySelectorAll('ol li').length") == 5
    assert browser.run(SHOWN) == ["dark" if dark else "light"] * 4
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert browser.run(CUT) == 0
    for corner, darkest, lightest in browser.run(SHADES):
        assert corner == 0  # the page is seen through
        assert lightest > 240 if dark else darkest < 15
    assert browser.troubles == []
