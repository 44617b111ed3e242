"""PyTorch on one thread: the tests' matrices are small, and pytest runs on all cores already."""

from __future__ import annotations

import torch

torch.set_num_threads(1)
