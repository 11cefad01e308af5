//! Ctrl-C, and SIGTERM, as what ends a future.

use std::{error::Error, process::ExitCode};

use smol::{channel::Receiver, future};

/// What is interrupted by Ctrl-C.
pub(crate) struct Interrupt(Receiver<()>);

/// The whole of a program that Ctrl-C may interrupt; says why it has failed.
pub(crate) fn run(
    program: &str,
    work: impl AsyncFnOnce(&Interrupt) -> Result<(), Box<dyn Error>>,
) -> ExitCode {
    let done = Interrupt::listen().and_then(|interrupt| smol::block_on(work(&interrupt)));
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{program}: {error}");
            ExitCode::FAILURE
        }
    }
}

impl Interrupt {
    /// From now on Ctrl-C does not end the process by itself.
    fn listen() -> Result<Self, Box<dyn Error>> {
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
