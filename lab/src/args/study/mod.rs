//! Options of the studies, and of work in shards.

mod honesty;
mod months;
mod paper;
mod shards;
mod stability;
mod tradeoff;

pub(crate) use honesty::HonestyOptions;
pub(crate) use months::MonthsOptions;
pub(crate) use paper::PaperOptions;
pub(crate) use shards::{DataSetShards, StudyShards};
pub(crate) use stability::StabilityOptions;
pub(crate) use tradeoff::{AdviseOptions, TradeoffOptions};
