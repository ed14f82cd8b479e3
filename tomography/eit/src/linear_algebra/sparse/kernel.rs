//! Compiles the same arithmetic for several instruction sets and selects one at run time.
//!
//! The default build uses SSE2, whose vectors are a quarter as wide as AVX-512's. The order of the operations is the
//! same everywhere; fused multiply-adds change the last bits.

/// a b + c, with one rounding or two.
pub(crate) trait MulAdd: Copy {
    fn mul_add(a: f64, b: f64, c: f64) -> f64;
    fn single_mul_add(a: f32, b: f32, c: f32) -> f32;
}

/// One rounding: on processors with the instruction.
#[derive(Clone, Copy)]
pub(crate) struct Fused;

impl MulAdd for Fused {
    #[inline(always)]
    fn mul_add(a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }

    #[inline(always)]
    fn single_mul_add(a: f32, b: f32, c: f32) -> f32 {
        a.mul_add(b, c)
    }
}

/// Two roundings: on all others.
#[derive(Clone, Copy)]
pub(crate) struct Separate;

impl MulAdd for Separate {
    #[inline(always)]
    fn mul_add(a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }

    #[inline(always)]
    fn single_mul_add(a: f32, b: f32, c: f32) -> f32 {
        a * b + c
    }
}

/// Work to compile for each processor; `run` and everything it calls must be `#[inline(always)]`.
pub(crate) trait Task {
    type Output;
    fn run<M: MulAdd>(self) -> Self::Output;
}

/// Runs a task with the widest vectors of this processor.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
pub(crate) fn widest<T: Task>(task: T) -> T::Output {
    if is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512dq")
    {
        // SAFETY: every feature that the function is compiled for was detected above
        return unsafe { avx512(task) };
    }
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: as above
        return unsafe { avx2(task) };
    }
    task.run::<Separate>()
}

/// Runs a task with the widest vectors of this processor.
#[cfg(target_arch = "aarch64")]
pub(crate) fn widest<T: Task>(task: T) -> T::Output {
    task.run::<Fused>()
}

/// Runs a task as the build compiled it.
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
pub(crate) fn widest<T: Task>(task: T) -> T::Output {
    task.run::<Separate>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
fn avx512<T: Task>(task: T) -> T::Output {
    task.run::<Fused>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn avx2<T: Task>(task: T) -> T::Output {
    task.run::<Fused>()
}
