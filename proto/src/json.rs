//! JSON forms of fields for which serde's default is unsuitable: nanoseconds and enumerations.

/// `i64` nanoseconds as a decimal string.
pub mod nanoseconds {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    /// Writes the number as a decimal string.
    pub fn serialize<S: Serializer>(value: &i64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(value)
    }

    /// Reads a decimal string.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<i64, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(|_| {
            D::Error::custom(format!(
                "expected nanoseconds as a string of digits, such as \"1700000000000000000\", found {text:?}"
            ))
        })
    }
}

/// Defines a module that serializes an enumeration as the lower-case name of its value, without the prefix.
macro_rules! enumeration {
    ($module:ident, $type:ty, $prefix:literal) => {
        #[doc = concat!("Values of `", stringify!($type), "` as lower-case words.")]
        pub mod $module {
            use serde::{Deserialize, Deserializer, Serializer, de::Error};

            /// The word for a value; `unspecified` for a number unknown to this version.
            pub fn word(value: i32) -> String {
                let known = <$type>::try_from(value).unwrap_or_default();
                known.as_str_name().trim_start_matches($prefix).to_ascii_lowercase()
            }

            /// Writes the value as its word.
            pub fn serialize<S: Serializer>(value: &i32, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(&word(*value))
            }

            /// Reads a word; an unknown one is an error.
            pub fn deserialize<'de, D: Deserializer<'de>>(
                deserializer: D,
            ) -> Result<i32, D::Error> {
                let text = String::deserialize(deserializer)?;
                let name = format!("{}{}", $prefix, text.to_ascii_uppercase());
                match <$type>::from_str_name(&name) {
                    Some(value) => Ok(value as i32),
                    None => {
                        Err(D::Error::custom(format!("unknown {} {text:?}", stringify!($module))))
                    }
                }
            }
        }
    };
}

enumeration!(life_stage, crate::v1::LifeStage, "LIFE_STAGE_");
enumeration!(camera_status, crate::v1::CameraStatus, "CAMERA_STATUS_");
enumeration!(pose_status, crate::v1::PoseStatus, "POSE_STATUS_");
enumeration!(event_kind, crate::v1::EventKind, "EVENT_KIND_");
enumeration!(agreement_state, crate::v1::AgreementState, "AGREEMENT_STATE_");
enumeration!(print_size_state, crate::v1::PrintSizeState, "PRINT_SIZE_STATE_");
enumeration!(time_base, crate::v1::TimeBase, "TIME_BASE_");
enumeration!(calibration_stage, crate::v1::CalibrationStage, "CALIBRATION_STAGE_");
enumeration!(calibration_apply, crate::v1::CalibrationApply, "CALIBRATION_APPLY_");
enumeration!(recording_state, crate::v1::RecordingState, "RECORDING_STATE_");
enumeration!(replay_from, crate::v1::ReplayFrom, "REPLAY_FROM_");
enumeration!(fused_place, crate::v1::FusedPlace, "FUSED_PLACE_");
enumeration!(fused_clock, crate::v1::FusedClock, "FUSED_CLOCK_");
enumeration!(push_times, crate::v1::PushTimes, "PUSH_TIMES_");

#[cfg(test)]
mod tests {
    use crate::v1::{LifeStage, ObjectState, Snapshot};

    #[test]
    fn json_keeps_times_exact_and_names_stages() {
        let snapshot = Snapshot {
            pose_time_ns: 1_700_000_000_123_456_789,
            objects: vec![ObjectState { stage: LifeStage::Tracked as i32, ..Default::default() }],
            ..Default::default()
        };
        let json = serde_json::to_value(&snapshot).unwrap();
        assert_eq!(json["pose_time_ns"], "1700000000123456789");
        assert_eq!(json["objects"][0]["stage"], "tracked");
        assert_eq!(json["objects"][0]["position"], serde_json::Value::Null);
        let back: Snapshot = serde_json::from_value(json).unwrap();
        assert_eq!(back, snapshot);
    }

    #[test]
    fn wrong_json_says_what_was_expected() {
        let error = serde_json::from_str::<Snapshot>(r#"{"pose_time_ns":"soon"}"#).unwrap_err();
        assert!(error.to_string().contains("expected nanoseconds"), "{error}");
        let error = serde_json::from_str::<ObjectState>(r#"{"stage":"gone"}"#).unwrap_err();
        assert!(error.to_string().contains("unknown life_stage \"gone\""), "{error}");
    }
}
