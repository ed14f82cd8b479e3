//! Frames as SCPI text between drivers and simulators, their transcripts, and a broken connection. `measuring` tests
//! the values.

pub mod frame_as_text;
mod lost_source;
mod transcript_replay;
