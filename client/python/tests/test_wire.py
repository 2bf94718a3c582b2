"""Decodes the golden messages of `proto/golden`, which the server's tests check too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roundel import LifeStage, Snapshot, v1

GOLDEN = Path(__file__).resolve().parents[3] / "proto/golden"
POSE_TIME_NS = 1_696_248_000_000_000_007

pytestmark = pytest.mark.skipif(not GOLDEN.is_dir(), reason="the golden messages are only in the repository")


def wire(name: str) -> bytes:
    return bytes.fromhex((GOLDEN / f"{name}.hex").read_text())


def numbered(size: int, base: float) -> np.ndarray:
    """A symmetric matrix of base + 10 row + column above the diagonal, counted from 1."""
    row, column = np.meshgrid(np.arange(1, size + 1), np.arange(1, size + 1), indexing="ij")
    return base + 10.0 * np.minimum(row, column) + np.maximum(row, column)


def test_a_snapshot_is_decoded() -> None:
    snapshot = Snapshot(v1.Snapshot.FromString(wire("snapshot")))
    assert (snapshot.sequence, snapshot.source_id, snapshot.pose_time_ns) == (41, "run-1", POSE_TIME_NS)
    assert snapshot.capture_time_ns == POSE_TIME_NS - 12_500_000
    assert snapshot.ids.tolist() == [3, 7] and snapshot.names == ["carrier", ""] and snapshot.codes == [12, None]
    assert snapshot.stages.tolist() == [LifeStage.TRACKED, LifeStage.PREDICTED]
    np.testing.assert_array_equal(snapshot.positions_m, [[1.5, -2.25, 0.5], [-3.0, 4.0, 0.25]])
    np.testing.assert_array_equal(snapshot.velocities_m_s[0], [0.25, -0.5, 0.125])
    np.testing.assert_array_equal(snapshot.accelerations_m_s2[0], [-1.0, 0.75, 0.0625])
    np.testing.assert_array_equal(snapshot.angular_velocities_rad_s[0], [0.01, -0.02, 0.75])
    np.testing.assert_array_equal(snapshot.orientations, [[0.1, 0.5, -0.5, 0.7], [0.0, 0.0, 0.0, 1.0]])
    assert snapshot.covariances is not None and snapshot.velocity_covariances is not None
    np.testing.assert_array_equal(snapshot.covariances[0], numbered(6, 0.0))
    # The velocity block of the covariance over position and velocity.
    np.testing.assert_array_equal(snapshot.velocity_covariances[0], numbered(6, 100.0)[3:, 3:])
    carrier, other = snapshot[0], snapshot[1]
    assert carrier.position_sigma_m is not None
    np.testing.assert_allclose(carrier.position_sigma_m, np.sqrt([11.0, 22.0, 33.0]))
    assert (carrier.age_ns, other.age_ns) == (12_500_000, 200_000_000)
    assert carrier.roundel == "coded" and other.roundel == "plain"
    # Direction of its x axis: the first column of the matrix of the quaternion 0.7 + 0.1 i + 0.5 j - 0.5 k.
    x_axis = snapshot.rotations[0, :, 0]
    np.testing.assert_allclose(x_axis, [0.0, -0.6, -0.8], atol=1e-12)
    assert carrier.yaw_rad == pytest.approx(np.arctan2(x_axis[1], x_axis[0])) and other.yaw_rad is None


def test_a_lean_snapshot_is_the_same_without_covariances() -> None:
    whole, lean = (Snapshot(v1.Snapshot.FromString(wire(name))) for name in ("snapshot", "lean_snapshot"))
    assert len(wire("lean_snapshot")) < len(wire("snapshot")) / 2
    assert lean.covariances is None and lean.velocity_covariances is None
    np.testing.assert_array_equal(lean.positions_m, whole.positions_m)
    np.testing.assert_array_equal(lean.orientations, whole.orientations)


def test_the_other_messages_are_decoded() -> None:
    frame = v1.FrameObservations.FromString(wire("observations"))
    assert (frame.camera, frame.frame, frame.capture_time_ns) == ("south", 1234, POSE_TIME_NS)
    full, empty = frame.detections
    assert (full.outer.center.u, full.outer.center.v) == (640.25, 359.75)
    assert (full.outer.semi_major_px, full.inner.semi_major_px, full.outer.angle_rad) == (20.0, 8.0, -0.5)
    assert (full.pose.normal.y, full.pose.normal.z, full.pose.yaw_rad) == (0.6, -0.8, 1.25)
    assert (full.code.number, full.code.zero.u) == (12, 651.5) and not empty.HasField("pose")
    camera = v1.Camera.FromString(wire("camera"))
    assert (camera.pose.position.x, camera.pose.orientation.w) == (-2.5, 0.7)
    # 1/64 s late, 2^-18 s/s, 2^-10 s.
    assert (camera.clock.offset_ms, camera.clock.deviation_ms) == (15.625, 0.9765625)
    assert camera.clock.skew_ppm == pytest.approx(1e6 / 2**18)
    assert camera.capture_clock.deviation_ms == 62.5 and camera.pose_status == v1.POSE_STATUS_CALIBRATED
    assert camera.agreement.position_deviation_m == 0.003 and camera.agreement.rotation_error_rad == 0.02
    assert v1.Object.FromString(wire("object")).last_seen_time_ns == POSE_TIME_NS - 5_000_000_000
    event = v1.Event.FromString(wire("event"))
    assert (event.kind, event.object_id, event.time_ns) == (v1.EVENT_KIND_OBJECT_RECOVERED, 3, POSE_TIME_NS)
