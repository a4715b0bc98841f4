"""Search with a prior: where a target may be, and paths that find most of it within a length."""

from skysweep.planning.prior.search import plan_search as plan_search
