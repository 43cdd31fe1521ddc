"""Match features by entropic optimal transport, which uses more of the style image than nearest neighbors do.

Each content feature f_i has edges E to its K nearest style features s_j, with cost C = 1 - cos. The plan T minimizes

    <T, C> - eps H(T) + tau KL(T^t 1 || b),   T 1 = a,   T = 0 outside E

with a the weights of the positions (sum 1) and b uniform over the style features that have an edge: each f_i is
fully matched, and a popular style feature becomes expensive. With G = exp(-C/eps), T = diag(u) G diag(v):

    u = a / (G v),   v = (b / (G^t u))^(tau / (tau + eps))        (unbalanced Sinkhorn iterations: Chizat et al. 2018)

tau = 0 is a softmax over the K nearest; the larger tau, the more evenly the style features are used. The form with K
edges is from CCFT ("SceneStyler", arXiv 2606.26754).
"""

import torch
import torch.nn.functional as F
from torch import Tensor

NEIGHBORS = 16  # K
BLUR = 0.05  # eps
ROUNDS = 5


@torch.no_grad()
def transport_targets(
    content: Tensor,  # [n, c] unit rows
    style: Tensor,  # [m, c] unit rows
    diversity: float,
    weights: Tensor | None = None,  # [n] > 0
) -> Tensor:
    """Return the target of each content row: sum_j T_ij s_j / a_i, [n, c], of at most unit length.

    The mean of 1 - <f_i, target_i> over positions, weighted by a, is <T, C>. There is no gradient through the plan.

    Args:
        diversity: tau, >= 0.
        weights: Proportional to a; None: equal weights.
    """
    count = min(NEIGHBORS, len(style))
    cosines, chosen = (content @ style.T).topk(count, dim=1)  # [n, K]
    kernel = torch.exp((cosines - 1) / BLUR)
    source = content.new_full((len(content),), 1 / len(content)) if weights is None else weights / weights.sum()
    flat = chosen.flatten()
    reached = content.new_zeros(len(style)).index_fill_(0, flat, 1.0)
    wanted = reached / reached.sum()
    scaling = content.new_ones(len(style))  # v
    exponent = diversity / (diversity + BLUR)
    for _ in range(ROUNDS):
        rows = source / (kernel * scaling[chosen]).sum(1)  # u
        arriving = torch.zeros_like(scaling).index_add_(0, flat, (kernel * rows[:, None]).flatten())
        scaling = torch.where(reached > 0, (wanted / arriving.clamp_min(1e-30)) ** exponent, scaling)
    plan = kernel * scaling[chosen]
    plan = plan / plan.sum(1, keepdim=True)
    return F.embedding_bag(chosen, style, per_sample_weights=plan, mode="sum")
