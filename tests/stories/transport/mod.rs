//! Frames as SCPI text between drivers and simulators, transcripts of it, and a broken link.
//! What the readings mean is in `measuring`.

pub mod frame_as_text;
mod lost_source;
mod transcript_replay;
