"""Old names of questions that have become part of others: which question, with which options set."""

from collections.abc import Mapping

from workbench.project import OldName

OLD_NAMES: Mapping[str, OldName] = {
    "classical": OldName("resonance", {"theory": "classical"}),
    "iron_kinematics": OldName("iron_cycle", {"compare": "dimensions"}),
    "orientator_limit": OldName("orientation_time", {"compare": "formula"}),
    "orientator_neglect": OldName("orientation_time", {"compare": "neglected"}),
}
