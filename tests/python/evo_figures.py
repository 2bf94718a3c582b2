"""What evo says of two trajectories in TUM's form: evo_figures.py TRUTH ESTIMATE DELTA, as JSON."""

import copy
import json
import sys

from evo.core import metrics, sync
from evo.tools import file_interface

truth, estimate = (file_interface.read_tum_trajectory_file(path) for path in sys.argv[1:3])
truth, estimate = sync.associate_trajectories(truth, estimate, max_diff=1e-6)
aligned = copy.deepcopy(estimate)
aligned.align(truth)


def figures(metric):
    metric.process_data((truth, aligned))
    return metric.get_all_statistics()


json.dump(
    {
        "samples": truth.num_poses,
        "ate": figures(metrics.APE(metrics.PoseRelation.translation_part)),
        "ate_deg": figures(metrics.APE(metrics.PoseRelation.rotation_angle_deg)),
        "rpe": figures(
            metrics.RPE(metrics.PoseRelation.translation_part, delta=int(sys.argv[3]), delta_unit=metrics.Unit.frames)
        ),
    },
    sys.stdout,
)
