from .batch.batch import BatchDataset as BatchDataset
from .batch.batch import BatchEntry as BatchEntry
from .batch.solved_case import BatchSettings as BatchSettings
from .batch.variation import BatchCase as BatchCase
from .batch.variation import batch_cases as batch_cases
