from .batch.dataset import BatchDataset as BatchDataset
from .batch.dataset import BatchEntry as BatchEntry
from .batch.solved_case import BatchSettings as BatchSettings
from .batch.variation import BatchCase as BatchCase
from .batch.variation import batch_cases as batch_cases
