//! The interface to the running session that the program serving the page must supply: maps in addition to those of the
//! daemon.

/// Unit of a map of standard deviations.
pub const DEVIATION: &str = "ln conductance";

/// A running session, as its record describes it. Its methods may be called at the same time. Readings are in V; `None`
/// for a missing one.
pub trait RunningModel: Send + Sync {
    /// Whether the session's own method makes a map within milliseconds, so that no provisional map is needed.
    fn is_fast(&self) -> bool;

    /// A map that takes milliseconds.
    ///
    /// # Errors
    /// A sentence: the method refuses the frame.
    fn provisional(&self, readings: &[Option<f64>]) -> Result<ProvisionalMap, String>;

    /// Standard deviation of ln conductance of each triangle; NaN if the frame gives no information about it.
    ///
    /// # Errors
    /// A sentence why it is unknown.
    fn deviation(&self, readings: &[Option<f64>]) -> Result<Vec<f32>, String>;
}

/// A map that is shown until the map of the session's own method arrives.
#[derive(Debug, Clone, PartialEq)]
pub struct ProvisionalMap {
    /// The method.
    pub method: String,
    /// `kPa` or `lost share`.
    pub unit: &'static str,
    /// Why the map is not exact, as a sentence.
    pub provisional: String,
    /// One value a triangle.
    pub values: Vec<f32>,
}
