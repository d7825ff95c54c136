from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

__version__: str
REVISION: str

def fly_study(
    wanted: Mapping[str, Any],
    program: str,
    law: Optional[type],
    progress: Optional[Callable[[int, int], Any]],
) -> None: ...
def compare(a: str, b: str, only: List[str]) -> Tuple[bool, str]: ...
def figures() -> List[Tuple[str, str, Optional[str], str]]: ...
def recording_tables(file: str, folder: str) -> str: ...
def observation_names(action: Optional[str], neighbours: int) -> List[str]: ...

class Worlds:
    vehicles: int
    neighbours: int
    step_s: float
    seed: int
    max_speed_m_s: float
    def __init__(self, settings: Mapping[str, Any]) -> None: ...
    def reset(
        self, seeds: Sequence[Optional[int]], observations: np.ndarray, truths: Dict[str, np.ndarray]
    ) -> None: ...
    def step(
        self, actions: Optional[np.ndarray], observations: np.ndarray, truths: Dict[str, np.ndarray]
    ) -> None: ...
    def report(self, world: int) -> Optional[str]: ...
