//! A value that follows from nodes, triangles and electrodes alone, made once for a mesh and its copies.

use std::any::Any;
use std::sync::{Arc, OnceLock};

/// Empty until the first use. The type of the value is its user's, so that the mesh does not depend on it. Copies of a mesh
/// with another region or depth share it; meshes are equal whatever they keep.
#[derive(Clone, Default)]
pub(crate) struct Kept(Arc<OnceLock<Arc<dyn Any + Send + Sync>>>);

impl Kept {
    /// The value; it is made if there is none of this type yet.
    ///
    /// # Errors
    /// Those of `make`, after which nothing is kept.
    pub(crate) fn or_make<T: Send + Sync + 'static, E>(
        &self,
        make: impl FnOnce() -> Result<T, E>,
    ) -> Result<Arc<T>, E> {
        let kept = self.0.get().cloned();
        if let Some(kept) = kept.and_then(|value| value.downcast::<T>().ok()) {
            return Ok(kept);
        }
        let made = Arc::new(make()?);
        // another thread can have made the same
        let _ = self.0.set(Arc::clone(&made) as Arc<dyn Any + Send + Sync>);
        Ok(made)
    }
}

impl PartialEq for Kept {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl std::fmt::Debug for Kept {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self.0.get() {
            None => "nothing kept",
            Some(_) => "kept",
        })
    }
}
