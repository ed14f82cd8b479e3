//! Many conductances on one mesh: analysis, memory and a shared factor are reused.

use std::sync::Arc;

use nalgebra::DVector;
use survey::Protocol;

use super::scratch::{Base, Scratch};
use super::{Fields, Forward, ForwardError};

/// Scratch of one thread, for the readings of one conductance after another.
///
/// A clone shares the analysis and has separate scratch: use one clone per thread (`rayon`'s `map_init`). Results
/// depend on the conductance alone, bit for bit, never on earlier ones.
///
/// ```
/// use std::sync::Arc;
/// use eit::{DiscTank, Forward};
/// use survey::Protocol;
/// let tank = DiscTank::default();
/// let mesh = Arc::new(tank.mesh()?);
/// let forward = Forward::new(mesh.clone(), &tank.contact_ohm_m())?;
/// let sigma0 = vec![tank.conductance(); mesh.triangles().len()];
/// let mut workspace = forward.workspace(&Protocol::sheffield(16)?)?.about(&sigma0)?;
/// let mut pressed = sigma0.clone();
/// pressed[17] *= 0.5;
/// let (before, after) = (workspace.readings(&sigma0)?, workspace.readings(&pressed)?);
/// assert!(before != after);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct Workspace<'f> {
    forward: &'f Forward,
    protocol: Arc<Protocol>,
    refined: bool,
    base: Option<Arc<Base>>,
    scratch: Scratch,
}

impl std::fmt::Debug for Workspace<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Workspace")
            .field("forward", self.forward)
            .field("refined", &self.refined)
            .finish_non_exhaustive()
    }
}

impl Forward {
    /// Scratch for the readings of many conductances with one protocol. They are refined; see [`Workspace::plain`].
    ///
    /// # Errors
    /// A protocol for another ring.
    pub fn workspace(&self, protocol: &Protocol) -> Result<Workspace<'_>, ForwardError> {
        self.check_ring(protocol)?;
        Ok(Workspace {
            forward: self,
            protocol: Arc::new(protocol.clone()),
            refined: true,
            base: None,
            scratch: Scratch::new(self)?,
        })
    }
}

impl Workspace<'_> {
    /// Skips the refinement: electrode voltages come from the factor alone, and no field is solved. On the paper's
    /// sheet this costs less than one digit of fifteen; loss of digits by extreme contrast is not detected.
    #[must_use]
    pub fn plain(mut self) -> Self {
        self.refined = false;
        self
    }

    /// Keeps the factor of a conductance (S, one per triangle): for later conductances only the part that differs from
    /// it is factored. Changes the speed, never the result.
    ///
    /// # Errors
    /// A conductance that is refused.
    pub fn about(mut self, sigma0: &[f64]) -> Result<Self, ForwardError> {
        self.base = Some(Arc::new(Scratch::base(self.forward, sigma0)?));
        Ok(self)
    }

    /// The readings of the protocol at 1 A, V, for a conductance (S, one per triangle).
    ///
    /// # Errors
    /// A conductance that is refused.
    pub fn readings(&mut self, sigma: &[f64]) -> Result<DVector<f64>, ForwardError> {
        let base = self.base.as_deref();
        let ring = self.scratch.ring(self.forward, sigma, base, self.refined)?;
        Ok(ring.readings(self.forward, &self.protocol))
    }

    /// The fields of the protocol's drives at 1 A, as [`Forward::solve`] gives them, for a conductance (S, one per
    /// triangle).
    ///
    /// # Errors
    /// A conductance that is refused.
    pub fn fields(&mut self, sigma: &[f64]) -> Result<Fields, ForwardError> {
        let currents = self.forward.currents(&self.protocol.drives())?;
        let base = self.base.as_deref();
        let solution = self
            .scratch
            .solution(self.forward, sigma, &currents, base, self.refined)?;
        let fields = self.forward.fields(&solution);
        self.forward.with_depth(fields, sigma, &currents)
    }
}
