//! The program's steps. Each begins with the axis enabled and standing, and knows nothing of the drive.

use servocrab::{BufferMode, HomingMethod, SetPoint};

use super::bench::{Bench, SWITCH, start};

type Step = fn(&mut Bench) -> String;

pub(crate) const STEPS: &[(&str, Step)] = &[
    ("an absolute move before the axis is referenced", |bench| {
        bench.abs(1_000, start(BufferMode::Buffered));
        bench.finish()
    }),
    ("homing where the axis stands", |bench| {
        bench.home(HomingMethod::CURRENT_POSITION, 0);
        bench.finish()
    }),
    ("homing by a method that no drive has", |bench| {
        bench.home(HomingMethod(99), 0);
        bench.finish()
    }),
    ("homing by the negative limit switch, halted", |bench| {
        bench.home(HomingMethod::NEGATIVE_LIMIT, SWITCH);
        bench.run(300);
        bench.axis(|axis| async move { axis.halt().await });
        bench.run(500);
        bench.axis(|axis| async move { axis.resume().await });
        bench.axis(|axis| async move { axis.stop().await });
        bench.finish()
    }),
    (
        "an absolute move after a homing that was not attained",
        |bench| {
            bench.abs(1_000, start(BufferMode::Buffered));
            bench.finish()
        },
    ),
    ("homing by the negative limit switch", |bench| {
        bench.home(HomingMethod::NEGATIVE_LIMIT, SWITCH);
        bench.finish()
    }),
    ("Aborting, at rest", |bench| {
        bench.abs(10_000, start(BufferMode::Aborting));
        bench.finish()
    }),
    ("Buffered, at rest", |bench| {
        bench.abs(0, start(BufferMode::Buffered));
        bench.finish()
    }),
    ("Blending, at rest", |bench| {
        bench.abs(5_000, start(BufferMode::Blending));
        bench.finish()
    }),
    ("Aborting over a move", |bench| {
        over(bench, BufferMode::Aborting)
    }),
    ("Buffered behind a move", |bench| {
        over(bench, BufferMode::Buffered)
    }),
    ("Blending behind a move", |bench| {
        over(bench, BufferMode::Blending)
    }),
    ("Blending back behind a move", |bench| {
        bench.abs(0, start(BufferMode::Buffered));
        bench.finish();
        bench.abs(40_000, start(BufferMode::Buffered));
        bench.run(100);
        bench.abs(0, start(BufferMode::Blending));
        bench.finish()
    }),
    ("Aborting over two moves", |bench| {
        bench.abs(0, start(BufferMode::Buffered));
        bench.finish();
        bench.abs(40_000, start(BufferMode::Buffered));
        bench.abs(50_000, start(BufferMode::Buffered));
        bench.run(200);
        bench.abs(-10_000, start(BufferMode::Aborting));
        bench.finish()
    }),
    ("four moves one after another", |bench| {
        for target in [0, 5_000, 5_000, 15_000] {
            bench.abs(target, start(BufferMode::Buffered));
        }
        bench.finish()
    }),
    ("relative moves", |bench| {
        bench.rel(3_000, start(BufferMode::Buffered));
        bench.rel(-8_000, start(BufferMode::Buffered));
        bench.finish()
    }),
    ("a relative move over a move", |bench| {
        bench.abs(0, start(BufferMode::Buffered));
        bench.finish();
        bench.abs(40_000, start(BufferMode::Buffered));
        bench.run(200);
        bench.rel(1_000, start(BufferMode::Aborting));
        bench.finish()
    }),
    ("halt and resume", |bench| {
        bench.abs(80_000, start(BufferMode::Buffered));
        bench.run(200);
        bench.axis(|axis| async move { axis.halt().await });
        bench.run(500);
        bench.abs(0, start(BufferMode::Buffered));
        bench.axis(|axis| async move { axis.resume().await });
        bench.finish()
    }),
    ("halt and stop", |bench| {
        bench.abs(0, start(BufferMode::Buffered));
        bench.run(200);
        bench.axis(|axis| async move { axis.halt().await });
        bench.run(500);
        bench.axis(|axis| async move { axis.stop().await });
        bench.finish()
    }),
    ("stop", |bench| {
        bench.abs(0, start(BufferMode::Buffered));
        bench.run(200);
        bench.axis(|axis| async move { axis.stop().await });
        bench.finish()
    }),
    ("quick stop", |bench| {
        bench.abs(0, start(BufferMode::Buffered));
        bench.run(200);
        bench.axis(|axis| async move { axis.quick_stop().await });
        bench.finish()
    }),
    ("disable on the way", |bench| {
        bench.abs(0, start(BufferMode::Buffered));
        bench.run(100);
        bench.axis(|axis| async move { axis.disable().await });
        bench.finish()
    }),
    ("a fault on the way", |bench| {
        bench.abs(100_000, start(BufferMode::Buffered));
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
        bench.abs(0, start(BufferMode::Buffered));
        bench.finish();
        bench.abs(10_000, start(BufferMode::Buffered).profile_type(1));
        bench.finish()
    }),
    ("Blending behind a move with sin² ramps", |bench| {
        bench.abs(0, start(BufferMode::Buffered).profile_type(1));
        bench.run(50);
        bench.abs(-10_000, start(BufferMode::Blending).profile_type(0));
        bench.finish()
    }),
    ("a jog", |bench| {
        bench.jog(40_000, 500);
        bench.finish()
    }),
    ("a jog, quick stopped", |bench| {
        bench.jog(-40_000, 500);
        bench.run(200);
        bench.axis(|axis| async move { axis.quick_stop().await });
        bench.finish()
    }),
    ("a jog, halted and resumed", |bench| {
        bench.jog(40_000, 2_000);
        bench.run(200);
        bench.axis(|axis| async move { axis.halt().await });
        bench.run(500);
        bench.axis(|axis| async move { axis.resume().await });
        bench.finish()
    }),
    ("a target beyond 607Dh", |bench| {
        // Around the home offset, by which they are corrected: 20 000 to either side of 0.
        bench.set_software_limits(SWITCH - 20_000, SWITCH + 20_000);
        bench.abs(20_001, start(BufferMode::Buffered));
        bench.run(50);
        bench.abs(20_000, start(BufferMode::Buffered));
        let found = bench.finish();
        bench.set_software_limits(0, 0);
        format!("{found}; then {}", bench.finish())
    }),
    ("a velocity of zero", |bench| {
        bench.abs(
            50_000,
            SetPoint::new()
                .velocity(0)
                .buffer_mode(BufferMode::Buffered),
        );
        bench.finish()
    }),
];

/// A move under way to 20 000 with another one behind or over it, to 30 000.
fn over(bench: &mut Bench, second: BufferMode) -> String {
    bench.abs(0, start(BufferMode::Buffered));
    bench.finish();
    bench.abs(20_000, start(BufferMode::Buffered));
    bench.run(200);
    bench.abs(30_000, start(second));
    bench.finish()
}
