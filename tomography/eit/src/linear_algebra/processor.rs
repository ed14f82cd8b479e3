//! Identification of the processor, on which the last bits of a map depend besides the build.

/// The processor features that affect arithmetic: the architecture, and the vector units selected at run time. Maps by
/// the same build on equal features have the same bits.
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
