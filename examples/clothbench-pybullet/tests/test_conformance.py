"""The model keeps every rule of the conformance kit."""

import pytest
from clothbench.testing import check_plugin, rule_names

from clothbench_pybullet.model import PybulletCloth

pytestmark = pytest.mark.skipif(PybulletCloth.skip_reason() is not None, reason="PyBullet is not installed")


@pytest.mark.parametrize("rule", rule_names("models"))
def test_the_model_keeps_every_rule(rule):
    check_plugin("models", "pybullet_cloth", only=[rule])
