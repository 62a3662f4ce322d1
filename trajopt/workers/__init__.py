"""Tasks in processes of their own behind the interface of `concurrent.futures`, their records and display."""

from trajopt.workers.executor import ProcessPerTaskExecutor
from trajopt.workers.task import LostTaskError, RefusedTaskError, TaskError, TaskTimeoutError

__all__ = ["LostTaskError", "ProcessPerTaskExecutor", "RefusedTaskError", "TaskError", "TaskTimeoutError"]
