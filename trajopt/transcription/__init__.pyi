from .stage_functions import Derivatives as Derivatives
from .transcription import transcribe as transcribe
