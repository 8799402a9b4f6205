"""What earlier tasks have cost, as the ledger sums it up: the basis of limits and of the order of work."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class TaskCosts:
    """Costs of earlier tasks, by stage and by task."""

    stages: dict[str, float] = field(default_factory=dict)
    """Median wall time of a stage's tasks, in seconds."""
    stages_mb: dict[str, float] = field(default_factory=dict)
    """Largest peak memory of a stage's tasks, in MB (2^20 bytes)."""
    tasks: dict[str, float] = field(default_factory=dict)
    """Wall time of a task, when it last ran, in seconds."""
    tasks_mb: dict[str, float] = field(default_factory=dict)
    """Peak memory of a task, when it last ran, in MB."""
    stages_bytes: dict[str, float] = field(default_factory=dict)
    """Mean size of a stage's artifacts on disk, in bytes."""

    def expected_seconds(self, stage: str, task: str) -> float:
        """Return the expected wall time of a task in seconds: that of its last run, else the median of its stage."""
        return self.tasks.get(task, self.stages.get(stage, 0.0))

    def expected_peak_mb(self, stage: str, task: str, others: float = 0.0) -> float:
        """Return the expected peak memory of a task in MB.  others: peak of its stage's tasks in the run so far."""
        return self.tasks_mb.get(task, max(others, self.stages_mb.get(stage, 0.0)))
