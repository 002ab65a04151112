"""Batches: many pairs, on this machine or on a cluster, with a log that survives whatever happens."""

from expert.batch.item import BatchItem, Stated
from expert.batch.local import Limits
from expert.batch.manifest import ManifestError
from expert.batch.run import Batch, ChangedSettings, Plan, Progress
from expert.batch.runlog import RunLog
from expert.batch.sources import find_pairs, select, timed
from expert.batch.work import Outcome, Settings

__all__ = [
    "Batch",
    "BatchItem",
    "ChangedSettings",
    "Limits",
    "ManifestError",
    "Outcome",
    "Plan",
    "Progress",
    "RunLog",
    "Settings",
    "Stated",
    "find_pairs",
    "select",
    "timed",
]
