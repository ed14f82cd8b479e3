//! Arbitrary bytes as replies to a VXI-11 client: each call ends with a result or an error, and never panics or hangs.

#![no_main]

use libfuzzer_sys::fuzz_target;
use tokio::io::AsyncWriteExt;

fuzz_target!(|bytes: &[u8]| {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder
        .enable_time()
        .start_paused(true)
        .build()
        .expect("a runtime");
    runtime.block_on(async {
        let (here, mut there) = tokio::io::duplex(1 << 20);
        there
            .write_all(bytes)
            .await
            .expect("the pipe holds the input");
        there.shutdown().await.expect("the pipe closes");
        let mut client = vxi11::Client::new(here);
        if let Ok(link) = client.create_link("inst0").await
            && client.write(link, b"*IDN?\n").await.is_ok()
            && let Ok(reply) = client.read(link, 1024).await
        {
            assert!(reply.len() <= bytes.len());
            client.destroy_link(link).await.ok();
        }
    });
});
