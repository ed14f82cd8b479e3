//! The panic hook. It logs a contained panic, and reports every other one to its subscribers.

use std::sync::{LazyLock, Once};

use tokio::sync::watch;

use crate::panics::containment;

/// Location of the last panic that was not contained.
static RECEIVED: LazyLock<watch::Sender<String>> = LazyLock::new(watch::Sender::default);
static INSTALLED: Once = Once::new();

/// Installs the hook. It calls the previous hook, which prints the panic, only if the panic is not contained.
pub(crate) fn install() {
    INSTALLED.call_once(|| {
        let prints = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if containment::is_contained() {
                return containment::log(panic);
            }
            let place = panic
                .location()
                .map_or_else(|| "nowhere".to_owned(), ToString::to_string);
            RECEIVED.send_replace(place);
            prints(panic);
        }));
    });
}

/// Subscribes to the locations of panics.
pub(crate) fn listen() -> watch::Receiver<String> {
    RECEIVED.subscribe()
}
