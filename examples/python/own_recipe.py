"""A recipe of your own, an annealed filter of four layers, followed through a recording: own_recipe.py RECORDING"""

import sys

import hypose
from hypose import Layer, SilhouetteXor, SmoothedWeight, kernels, resampling

s = hypose.human().skeleton
steps = [kernels.GaussianDiffusion(0.6**k * s.sigma, s.lower, s.upper) for k in range(4)]
layers = [Layer(step, SmoothedWeight(SilhouetteXor(), survival=0.2), resampling.systematic) for step in steps]
mine = hypose.Recipe("mine", layers, particles=200, needs=("silhouettes",), estimate=hypose.pose_mean(s))
result = hypose.track(sys.argv[1], recipe=mine)
print(f"{len(result.motion)} frames, the masks overlap by {1 - result.motion.cost.mean():.2f}")
