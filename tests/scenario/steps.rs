//! The program's steps. Each begins with the axis enabled and standing, and knows nothing of the drive.

use servocrab::profile_position::{SetPoint, Start};

use crate::bench::{Bench, start};

type Step = fn(&mut Bench) -> String;

pub(crate) const STEPS: &[(&str, Step)] = &[
    ("Immediately, at rest", |bench| {
        bench.abs(10_000, start(Start::Immediately));
        bench.finish()
    }),
    ("AfterCurrent, at rest", |bench| {
        bench.abs(0, start(Start::AfterCurrent));
        bench.finish()
    }),
    ("Blend, at rest", |bench| {
        bench.abs(5_000, start(Start::Blend));
        bench.finish()
    }),
    ("Immediately over a move", |bench| {
        over(bench, Start::Immediately)
    }),
    ("AfterCurrent behind a move", |bench| {
        over(bench, Start::AfterCurrent)
    }),
    ("Blend behind a move", |bench| over(bench, Start::Blend)),
    ("Blend back behind a move", |bench| {
        bench.abs(0, start(Start::AfterCurrent));
        bench.finish();
        bench.abs(40_000, start(Start::AfterCurrent));
        bench.run(100);
        bench.abs(0, start(Start::Blend));
        bench.finish()
    }),
    ("Immediately over two moves", |bench| {
        bench.abs(0, start(Start::AfterCurrent));
        bench.finish();
        bench.abs(40_000, start(Start::AfterCurrent));
        bench.abs(50_000, start(Start::AfterCurrent));
        bench.run(200);
        bench.abs(-10_000, start(Start::Immediately));
        bench.finish()
    }),
    ("four moves one after another", |bench| {
        for target in [0, 5_000, 5_000, 15_000] {
            bench.abs(target, start(Start::AfterCurrent));
        }
        bench.finish()
    }),
    ("relative moves", |bench| {
        bench.rel(3_000, start(Start::AfterCurrent));
        bench.rel(-8_000, start(Start::AfterCurrent));
        bench.finish()
    }),
    ("a relative move over a move", |bench| {
        bench.abs(0, start(Start::AfterCurrent));
        bench.finish();
        bench.abs(40_000, start(Start::AfterCurrent));
        bench.run(200);
        bench.rel(1_000, start(Start::Immediately));
        bench.finish()
    }),
    ("halt and resume", |bench| {
        bench.abs(80_000, start(Start::AfterCurrent));
        bench.run(200);
        bench.axis(|axis| async move { axis.halt().await });
        bench.run(500);
        bench.abs(0, start(Start::AfterCurrent));
        bench.axis(|axis| async move { axis.resume().await });
        bench.finish()
    }),
    ("halt and stop", |bench| {
        bench.abs(0, start(Start::AfterCurrent));
        bench.run(200);
        bench.axis(|axis| async move { axis.halt().await });
        bench.run(500);
        bench.axis(|axis| async move { axis.stop().await });
        bench.finish()
    }),
    ("stop", |bench| {
        bench.abs(0, start(Start::AfterCurrent));
        bench.run(200);
        bench.axis(|axis| async move { axis.stop().await });
        bench.finish()
    }),
    ("quick stop", |bench| {
        bench.abs(0, start(Start::AfterCurrent));
        bench.run(200);
        bench.axis(|axis| async move { axis.quick_stop().await });
        bench.finish()
    }),
    ("disable on the way", |bench| {
        bench.abs(0, start(Start::AfterCurrent));
        bench.run(100);
        bench.axis(|axis| async move { axis.disable().await });
        bench.finish()
    }),
    ("a fault on the way", |bench| {
        bench.abs(100_000, start(Start::AfterCurrent));
        bench.run(200);
        bench.fault(0x7305);
        bench.run(1_000);
        bench.finish()
    }),
    ("fault, reset, enable", |bench| {
        bench.fault(0x7305);
        bench.run(200);
        bench.axis(|axis| async move { axis.enable().await });
        bench.run(100);
        bench.axis(|axis| async move { axis.reset_fault().await });
        bench.run(500);
        bench.axis(|axis| async move { axis.enable().await });
        bench.finish()
    }),
    ("sin² ramps", |bench| {
        bench.abs(0, start(Start::AfterCurrent));
        bench.finish();
        bench.abs(10_000, start(Start::AfterCurrent).profile_type(1));
        bench.finish()
    }),
    ("Blend behind a move with sin² ramps", |bench| {
        bench.abs(0, start(Start::AfterCurrent).profile_type(1));
        bench.run(50);
        bench.abs(-10_000, start(Start::Blend).profile_type(0));
        bench.finish()
    }),
    ("a velocity of zero", |bench| {
        bench.abs(
            50_000,
            SetPoint::new().velocity(0).start(Start::AfterCurrent),
        );
        bench.finish()
    }),
];

/// A move under way to 20 000 with another one behind or over it, to 30 000.
fn over(bench: &mut Bench, second: Start) -> String {
    bench.abs(0, start(Start::AfterCurrent));
    bench.finish();
    bench.abs(20_000, start(Start::AfterCurrent));
    bench.run(200);
    bench.abs(30_000, start(second));
    bench.finish()
}
