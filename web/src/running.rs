//! What the program that serves the page must supply of the running session: maps beside those of the daemon.

/// Unit of a map of standard deviations.
pub const DEVIATION: &str = "ln conductance";

/// A running session, as its record describes it. Its methods may be called at the same time. Readings are in V; `None` for
/// one that is no voltage.
pub trait RunningModel: Send + Sync {
    /// Whether the session's own method makes a map within milliseconds, so that no other is needed before it.
    fn is_fast(&self) -> bool;

    /// A map that takes milliseconds.
    ///
    /// # Errors
    /// A sentence: the method refuses the frame.
    fn provisional(&self, readings: &[Option<f64>]) -> Result<ProvisionalMap, String>;

    /// Standard deviation of ln conductance of each triangle; NaN if the frame gives no information about it.
    ///
    /// # Errors
    /// A sentence: it is not known.
    fn deviation(&self, readings: &[Option<f64>]) -> Result<Vec<f32>, String>;
}

/// A map that is shown until that of the session's own method comes.
#[derive(Debug, Clone, PartialEq)]
pub struct ProvisionalMap {
    /// The method.
    pub method: String,
    /// `kPa` or `lost share`.
    pub unit: &'static str,
    /// What is not exact about it, as a sentence.
    pub provisional: String,
    /// One value a triangle.
    pub values: Vec<f32>,
}
