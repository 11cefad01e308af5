//! Ctrl-C, and SIGTERM, as what ends a future.

use std::error::Error;

use smol::{channel::Receiver, future};

/// What is interrupted by Ctrl-C.
pub(crate) struct Interrupt(Receiver<()>);

impl Interrupt {
    /// From now on Ctrl-C does not end the process by itself.
    pub(crate) fn listen() -> Result<Self, Box<dyn Error>> {
        let (interrupt, interrupted) = smol::channel::bounded(1);
        ctrlc::set_handler(move || {
            // One is enough: the program is on its way out then.
            let _ = interrupt.try_send(());
        })?;
        Ok(Self(interrupted))
    }

    /// The output of a future; none where Ctrl-C comes before it is ready.
    pub(crate) async fn or<T>(&self, work: impl Future<Output = T>) -> Option<T> {
        let interrupted = async {
            // An error means that nobody can interrupt any more.
            if self.0.recv().await.is_err() {
                future::pending::<()>().await;
            }
            None
        };
        future::or(interrupted, async { Some(work.await) }).await
    }
}
