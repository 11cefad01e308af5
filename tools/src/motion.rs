//! One axis, moved: by a velocity for a time, to its home, or to a position. All else on the line stays as it is.

use std::time::Duration;

use clap::Args;
use serde_json::{Value, json};
use servocrab::{
    Axis, AxisConfig, BufferMode, HomingMethod, HomingParameters, Network, Outcome, Referencing,
    SetPoint, coe::obj, profile_velocity::JogSetPoint,
};

use crate::{
    axes::{DrivesArguments, FoundAxis},
    machine::Units,
    output::{Done, Failure, Interrupted, Tool},
};

/// Which axis, and how it is driven.
#[derive(Args)]
pub(crate) struct AxisArguments {
    #[command(flatten)]
    drives: DrivesArguments,
    /// The axis by its name: 0-1 is the first of the drive at position 0, unless the machine's file has another. Without it: the only axis
    #[arg(long, value_name = "NAME")]
    axis: Option<String>,
    /// Move without a question
    #[arg(long)]
    yes: bool,
}

/// Moves with a velocity for a time, and stops. Ctrl-C stops at once.
#[derive(Args)]
pub(crate) struct Jog {
    #[command(flatten)]
    axis: AxisArguments,
    /// Target velocity 60FFh, in the axis' unit a second; its sign is the direction
    #[arg(long, allow_negative_numbers = true)]
    velocity: f64,
    /// Profile acceleration and deceleration 6083h and 6084h; without it, what the drive holds
    #[arg(long)]
    acceleration: Option<f64>,
    /// How long to move
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=60_000))]
    milliseconds: u32,
}

/// Has the drive find its home. Ctrl-C stops at once.
#[derive(Args)]
pub(crate) struct Home {
    #[command(flatten)]
    axis: AxisArguments,
    /// Homing method 6098h: 17 negative limit switch, 18 positive, 33 and 34 index pulse, 37 where it stands
    #[arg(long, allow_negative_numbers = true)]
    method: i8,
    /// Speeds 6099h:1 and 6099h:2 during the search for the switch and for zero; without them, what the drive holds
    #[arg(long, num_args = 2, value_names = ["SWITCH", "ZERO"])]
    speeds: Option<Vec<f64>>,
    /// Homing acceleration 609Ah; without it, what the drive holds
    #[arg(long)]
    acceleration: Option<f64>,
    /// Home offset 607Ch; without it, what the drive holds
    #[arg(long, allow_negative_numbers = true)]
    offset: Option<f64>,
    /// An axis that has not found its home after so many seconds is stopped
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=3600))]
    seconds: u32,
}

/// Moves to a position or by a distance. Ctrl-C stops at once.
#[derive(Args)]
#[command(group(clap::ArgGroup::new("target").required(true).args(["to", "by"])))]
pub(crate) struct Move {
    #[command(flatten)]
    axis: AxisArguments,
    /// To this position, in the axis' unit; the axis must know where it is
    #[arg(long, allow_negative_numbers = true)]
    to: Option<f64>,
    /// By this distance, in the axis' unit
    #[arg(long, allow_negative_numbers = true)]
    by: Option<f64>,
    /// Profile velocity 6081h, in the axis' unit a second; without it, what the drive holds
    #[arg(long)]
    velocity: Option<f64>,
    /// Profile acceleration and deceleration 6083h and 6084h; without it, what the drive holds
    #[arg(long)]
    acceleration: Option<f64>,
    /// The position is a count of the drive, wherever that began: move without a homing
    #[arg(long)]
    unreferenced: bool,
}

pub(crate) async fn jog(tool: &Tool, arguments: &Jog) -> Done {
    let config = |axis: AxisConfig| axis.map_output(obj::TARGET_VELOCITY);
    let what = format!(
        "jog with {} for {} ms",
        arguments.velocity, arguments.milliseconds
    );
    let time = Duration::from_millis(arguments.milliseconds.into());
    run(
        tool,
        &arguments.axis,
        &what,
        config,
        async |net, axis, units| {
            let mut set_point = JogSetPoint::new(units.target_velocity(arguments.velocity)?);
            if let Some(ramp) = arguments.acceleration {
                let ramp = units.acceleration(ramp)?;
                set_point = set_point.acceleration(ramp).deceleration(ramp);
            }
            let velocities = axis.profile_velocity().await?;
            let held = velocities.jog(set_point).await?;
            net.clock().sleep(time).await?;
            // With the reason, where something has ended it meanwhile.
            held.release().await?;
            velocities.release().await?;
            Ok("jogged".into())
        },
    )
    .await
}

pub(crate) async fn home(tool: &Tool, arguments: &Home) -> Done {
    let what = format!("home by method {}", arguments.method);
    let config = |axis: AxisConfig| axis;
    run(
        tool,
        &arguments.axis,
        &what,
        config,
        async |_, axis, units| {
            let mut parameters = HomingParameters::new(HomingMethod(arguments.method));
            if let Some([switch, zero]) = arguments.speeds.as_deref() {
                parameters = parameters.speeds(units.velocity(*switch)?, units.velocity(*zero)?);
            }
            if let Some(acceleration) = arguments.acceleration {
                parameters = parameters.acceleration(units.acceleration(acceleration)?);
            }
            if let Some(offset) = arguments.offset {
                parameters = parameters.offset(units.home_offset(offset)?);
            }
            let homing = axis.homing().await?;
            let limit = Duration::from_secs(arguments.seconds.into());
            let homed = homing.home(parameters).within(limit).await?;
            homing.release().await?;
            Ok(format!("homed at {}", units.show(homed.position)))
        },
    )
    .await
}

pub(crate) async fn move_axis(tool: &Tool, arguments: &Move) -> Done {
    let referencing = match arguments.unreferenced {
        true => Referencing::UnreferencedMovesAllowed,
        false => Referencing::ByHoming,
    };
    let with = match arguments.velocity {
        Some(velocity) => velocity.to_string(),
        None => "the velocity that the drive holds".to_owned(),
    };
    let what = match arguments.to {
        Some(target) => format!("move to {target} with {with}"),
        None => format!("move by {} with {with}", arguments.by.unwrap_or(0.0)),
    };
    let config = |axis: AxisConfig| axis.referencing(referencing);
    run(tool, &arguments.axis, &what, config, async |_, axis, units| {
        // The axis stands, and some drives can replace no move.
        let mut set_point = SetPoint::new().buffer_mode(BufferMode::Buffered);
        if let Some(velocity) = arguments.velocity {
            set_point = set_point.velocity(units.velocity(velocity)?);
        }
        if let Some(ramp) = arguments.acceleration {
            let ramp = units.acceleration(ramp)?;
            set_point = set_point.acceleration(ramp).deceleration(ramp);
        }
        let end = units.position(arguments.to.or(arguments.by).unwrap_or(0.0))?;
        let positions = axis.profile_position().await?;
        let motion = if arguments.to.is_some() {
            let begun = positions.move_abs(end, set_point).await;
            begun.map_err(|error| match error.failure() {
                Some(servocrab::Failure::NotReferenced) => Failure::from(
                    "the axis is not referenced: home it by `servocrab home`, or say --unreferenced to take the drive's counts as they are",
                ),
                _ => error.into(),
            })?
        } else {
            positions.move_rel(end, set_point).await?
        };
        let outcome = motion.done().await?;
        positions.release().await?;
        Ok(match (outcome, arguments.to) {
            (Outcome::Passed { position }, _) => format!("passed {}", units.show(position)),
            (_, Some(target)) => format!("reached, within the window of {target}"),
            (_, None) => "reached, within the window of its end".into(),
        })
    })
    .await
}

/// Brings the drives into OP, enables the axis, does the work, and disables it, whatever becomes of the work.
async fn run(
    tool: &Tool,
    arguments: &AxisArguments,
    what: &str,
    config: impl Fn(AxisConfig) -> AxisConfig,
    work: impl AsyncFnOnce(&Network, &Axis, Units) -> Result<String, Failure>,
) -> Done {
    let named = arguments.axis.as_deref();
    let drives = &arguments.drives;
    let is_chosen = |name: &str| named.is_none_or(|named| named == name);
    let settings = |found: &FoundAxis, axis| match is_chosen(&found.name) {
        true => config(axis),
        false => axis,
    };
    let found = drives.find(tool, settings).await?;
    let chosen = found.axis(named)?;
    let (name, units, position) = (chosen.name.clone(), chosen.units, chosen.drive.position);
    let question = format!(
        "Axis {name} of {} is going to move ({what}, in {}). Is everybody clear of it?",
        chosen.drive,
        units.name()
    );
    tool.agreed(arguments.yes, &question).await?;
    let network = drives.network(found.only(position))?;
    let start = drives.described.start(network);
    let net = tool.unless_interrupted(start).await?;
    let axis = net.axis(&name)?;
    let emergencies = net.all_emergencies();
    let before = units.show(axis.status().position);
    let moved = tool
        .unless_interrupted(async {
            axis.enable().await?;
            work(&net, &axis, units).await
        })
        .await;
    // Stops the axis where it is moving, by halt and quick stop, then disables it.
    let disabled = axis.disable().await;
    let status = axis.status();
    let position = units.show(status.position);
    while let Some(report) = emergencies.try_next() {
        tool.note(report);
    }
    let ended = net.shutdown().await;
    let left = disabled.err().map(Failure::from).into_iter();
    let left: Vec<_> = left.chain(ended.err().map(Failure::from)).collect();
    let (outcome, failed) = match moved {
        Ok(outcome) => (Some(outcome), None),
        Err(error) => (None, Some(error)),
    };
    let said = outcome.map_or(Ok(()), |outcome| {
        let json: Value = json!({
            "outcome": outcome,
            "from": before,
            "position": position,
            "referenced": status.referenced,
        });
        let state = if left.is_empty() { "disabled at" } else { "at" };
        let text = format_args!("{outcome}; {state} {position}, from {before}\n");
        tool.say(&json, text)
    });
    let mut failures = failures(failed, left, position);
    failures.extend(said.err().map(Failure::from));
    let mut failures = failures.into_iter();
    let first = failures.next();
    failures.for_each(|other| tool.note(other));
    first.map_or(Ok(true), Err)
}

/// Why the move has failed, and then how the axis was left, where that is not as it should be: neither hides the other.
fn failures(failed: Option<Failure>, left: Vec<Failure>, position: f64) -> Vec<Failure> {
    let failed = failed.map(|error| match error.is::<Interrupted>() && left.is_empty() {
        true => format!("interrupted: stopped and disabled at {position}").into(),
        false => error,
    });
    failed.into_iter().chain(left).collect()
}

#[cfg(test)]
mod tests {
    use servocrab::NetworkError;

    use super::*;

    #[test]
    fn an_axis_that_is_left_moving_is_named_whatever_became_of_its_move() {
        let moving = || Failure::from(NetworkError::StillMoving(Vec::new()));
        let texts = |failed, left| {
            let all = failures(failed, left, 7.0);
            all.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        let still = moving().to_string();
        assert_eq!(texts(None, vec![moving()]), [still.as_str()]);
        assert_eq!(
            texts(
                Some("the drive is lost".into()),
                vec!["not disabled".into(), moving()]
            ),
            ["the drive is lost", "not disabled", &still]
        );
        assert_eq!(
            texts(Some(Interrupted.into()), vec![moving()]),
            ["interrupted", &still]
        );
        assert_eq!(
            texts(Some(Interrupted.into()), Vec::new()),
            ["interrupted: stopped and disabled at 7"]
        );
        assert!(texts(None, Vec::new()).is_empty());
    }
}
