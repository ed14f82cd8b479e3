//! Commands that make training sets and train models; the crate `training` contains the algorithms.

mod data;
mod dataset;
mod deep;
mod limits;
mod linear;
mod model_file;
mod rbf;
mod recorded;
mod settings_file;

use studies::Failure;

use crate::args::Network;
pub(crate) use dataset::{dataset, stop_request};

/// Trains and writes the model file.
pub(crate) fn train(network: &Network) -> Result<(), Failure> {
    match network {
        Network::Rbf(options) => rbf::train(options),
        Network::Dnn(options) => deep::train(options),
        Network::Linear(options) => linear::train(options),
    }
}
