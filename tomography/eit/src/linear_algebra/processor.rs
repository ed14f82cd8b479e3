//! What decides the last bits of a map beside the build.

/// The processor as far as arithmetic depends on it: the architecture, and the vector units that are chosen by what is
/// there. Maps made by the same build on the same are the same to the last bit.
pub fn cpu_features() -> String {
    #[cfg(target_arch = "x86_64")]
    {
        let features = [
            ("avx512f", std::arch::is_x86_feature_detected!("avx512f")),
            ("avx2", std::arch::is_x86_feature_detected!("avx2")),
            ("fma", std::arch::is_x86_feature_detected!("fma")),
        ];
        let names: Vec<&str> = features
            .into_iter()
            .filter_map(|(name, there)| there.then_some(name))
            .collect();
        format!("x86_64 {}", names.join(" "))
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        std::env::consts::ARCH.to_owned()
    }
}
