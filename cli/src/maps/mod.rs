//! Maps made without a daemon: settings, sources of frames, reconstruction, replay, drawing. The mathematics is in the
//! crate `eit`.

pub(crate) mod compared;
pub(crate) mod drawing;
pub(crate) mod follower;
pub(crate) mod frame_maps;
pub(crate) mod pictures;
pub(crate) mod playback;
pub(crate) mod quantities;
pub(crate) mod reconstruction;
pub(crate) mod recording;
pub(crate) mod replay;
pub(crate) mod session_settings;
pub(crate) mod settings;
