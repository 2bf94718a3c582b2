//! The numbers of the recording that is being made, or of the last one.

use super::MetricsText;
use crate::archive::record::{RecordingState, RecordingStatus};

pub(super) fn write_recording(page: &mut MetricsText, status: &RecordingStatus) {
    let name = "roundel_recording_state";
    page.family(
        name,
        "gauge",
        "1 for how the recording is: none since the start, being made, ended, ended by itself.",
    );
    for (state, word) in [
        (RecordingState::Idle, "idle"),
        (RecordingState::Recording, "recording"),
        (RecordingState::Stopped, "stopped"),
        (RecordingState::Failed, "failed"),
    ] {
        page.sample(name, &[("state", word)], f64::from(u8::from(status.state == state)));
    }
    for (name, help, number) in [
        ("roundel_recording_bytes", "Bytes in all its files.", status.bytes as f64),
        ("roundel_recording_files", "Its files.", f64::from(status.files)),
        ("roundel_recording_messages", "Messages in its files.", status.messages as f64),
        (
            "roundel_recording_dropped_messages",
            "Messages that are missing in its files, since the disk was too slow.",
            status.dropped as f64,
        ),
        ("roundel_recording_seconds", "How long it has lasted.", status.seconds),
        (
            "roundel_recording_disk_free_bytes",
            "What its disk had left when it was looked at last; 0 before the first recording.",
            status.disk_free_bytes as f64,
        ),
    ] {
        page.single(name, "gauge", help, number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_that_ended_by_itself_is_told_from_one_that_runs() {
        let mut page = MetricsText::default();
        let status = RecordingStatus {
            state: RecordingState::Failed,
            dropped: 7,
            ..RecordingStatus::default()
        };
        write_recording(&mut page, &status);
        for line in [
            "roundel_recording_state{state=\"failed\"} 1",
            "roundel_recording_state{state=\"recording\"} 0",
            "roundel_recording_dropped_messages 7",
        ] {
            assert!(page.text.lines().any(|found| found == line), "{}", page.text);
        }
    }
}
