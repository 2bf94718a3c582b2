"""Reads a recording with the mcap package and its protobuf support, and says what it found, as JSON."""

import json
import sys
from collections import Counter

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

counts, cameras, objects, poses, images = Counter(), set(), set(), [], Counter()
with open(sys.argv[1], "rb") as stream:
    reader = make_reader(stream, decoder_factories=[DecoderFactory()])
    summary = reader.get_summary()
    for schema, channel, _, decoded in reader.iter_decoded_messages():
        counts[channel.topic] += 1
        if schema.name == "roundel.v1.FrameObservations":
            cameras.add(decoded.camera)
        elif schema.name == "roundel.v1.Snapshot":
            poses.append(decoded.pose_time_ns)
            objects.update(state.object_id for state in decoded.objects)
            assert all(len(state.covariance) == 21 for state in decoded.objects)
        elif schema.name == "foxglove.CompressedImage":
            images[decoded.format] += decoded.data[:4] == b"\x89PNG" or decoded.data[:2] == b"\xff\xd8"
json.dump(
    {
        "counts": counts,
        "promised": summary.statistics.message_count if summary else None,
        "cameras": sorted(cameras),
        "objects": len(objects),
        "ascending": poses == sorted(poses),
        "images": images,
    },
    sys.stdout,
)
