//! A cached value that depends only on nodes, triangles and electrodes, computed once for a mesh and its copies.

use std::any::Any;
use std::sync::{Arc, OnceLock};

/// The cache, empty until its first use. The user determines the type of the value, so that the mesh does not depend on
/// that type. Copies of a mesh with another region or depth share the cache; it is ignored when meshes are compared.
#[derive(Clone, Default)]
pub(crate) struct Kept(Arc<OnceLock<Arc<dyn Any + Send + Sync>>>);

impl Kept {
    /// The cached value; it is computed if the cache has none of this type.
    ///
    /// # Errors
    /// The errors of `make`; the cache then stays empty.
    pub(crate) fn or_make<T: Send + Sync + 'static, E>(
        &self,
        make: impl FnOnce() -> Result<T, E>,
    ) -> Result<Arc<T>, E> {
        let kept = self.0.get().cloned();
        if let Some(kept) = kept.and_then(|value| value.downcast::<T>().ok()) {
            return Ok(kept);
        }
        let made = Arc::new(make()?);
        // another thread may have computed an equal value
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
