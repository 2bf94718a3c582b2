//! What recordings say beside the messages that clients get, and how they are doing.

use roundel_proto::v1;

use crate::archive::{
    history::store::{HistoryPoint, HistoryResult},
    record::{RecordingState, RecordingStatus, folder::RecordingFile},
    replay,
};

pub fn recording(status: &RecordingStatus) -> v1::Recording {
    let state = match status.state {
        RecordingState::Idle => v1::RecordingState::Idle,
        RecordingState::Recording => v1::RecordingState::Recording,
        RecordingState::Stopped => v1::RecordingState::Stopped,
        RecordingState::Failed => v1::RecordingState::Failed,
    };
    v1::Recording {
        state: state.into(),
        file: status.file.clone(),
        folder: status.folder.display().to_string(),
        started_time_ns: status.started.as_ns(),
        seconds: status.seconds,
        bytes: status.bytes,
        files: status.files,
        messages: status.messages,
        dropped: status.dropped,
        disk_free_bytes: status.disk_free_bytes,
        budget_bytes: status.budget_bytes,
        deleted: status.deleted,
        error: status.error.clone(),
        frames_every: status.frames_every,
    }
}

/// The files of a folder; `open` is being written.
pub fn recordings(
    folder: &std::path::Path,
    files: &[RecordingFile],
    open: Option<&str>,
) -> v1::ListRecordingsResponse {
    let file = |file: &RecordingFile| v1::RecordingFile {
        name: file.name.clone(),
        bytes: file.bytes,
        started_time_ns: file.started.as_ns(),
        open: open == Some(file.name.as_str()),
    };
    let folder = folder.display().to_string();
    v1::ListRecordingsResponse { files: files.iter().map(file).collect(), folder }
}

/// A recording that is being played.
pub fn replay(status: &replay::ReplayStatus) -> v1::Replay {
    let (begin, end) = status.span;
    let from = match status.from {
        replay::ReplayFrom::Snapshots => v1::ReplayFrom::Snapshots,
        replay::ReplayFrom::Observations => v1::ReplayFrom::Observations,
        replay::ReplayFrom::Frames => v1::ReplayFrom::Frames,
    };
    v1::Replay {
        file: status.file.display().to_string(),
        from: from.into(),
        paused: status.paused,
        speed: status.speed,
        looping: status.looping,
        position_s: status.position.seconds_since(begin),
        duration_s: end.seconds_since(begin),
        begin_time_ns: begin.as_ns(),
        position_time_ns: status.position.as_ns(),
        ended: status.ended,
        damage: status.damage.join("; "),
    }
}

pub fn history(answer: &HistoryResult) -> v1::QueryHistoryResponse {
    let point = |point: &HistoryPoint| {
        let [x, y, z] = point.position_m;
        v1::HistoryPoint {
            time_ns: point.time.as_ns(),
            position: Some(v1::Vector3 { x, y, z }),
            yaw_rad: point.yaw_rad,
        }
    };
    let each = answer.objects.iter().map(|(identity, points)| v1::ObjectHistory {
        object_id: identity.id,
        source_id: identity.run.clone(),
        name: identity.name.clone(),
        roundel: identity.kind.clone(),
        code: identity.code,
        points: points.iter().map(point).collect(),
    });
    let points: usize = answer.objects.iter().map(|(_, points)| points.len()).sum();
    let (oldest, newest) = answer.kept.unwrap_or_default();
    v1::QueryHistoryResponse {
        objects: each.collect(),
        step_s: answer.step_s,
        points: points as u32,
        oldest_time_ns: oldest.as_ns(),
        newest_time_ns: newest.as_ns(),
    }
}
