"""The tasks by the id of their environment."""

from .interface import TASK
from .job_interface import CONTOUR, CUTTING

TASKS = {task.id: task for task in (TASK, CONTOUR, CUTTING)}
