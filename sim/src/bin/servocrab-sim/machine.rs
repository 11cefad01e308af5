//! The machine that the drives move, as options of the program: the same for each axis.

use clap::Args;
use servocrab_sim::ds402::{Machine, Mark};

/// All positions are in encoder counts from the machine's own zero.
#[derive(Args, Clone, Debug)]
pub(crate) struct MachineArguments {
    /// Where each axis stands at power-up
    #[arg(
        long,
        value_name = "COUNTS",
        default_value_t = 0,
        allow_negative_numbers = true
    )]
    stands_at: i64,
    /// Limit switches: active up to LOW and from HIGH on
    #[arg(long, value_name = "LOW..HIGH", value_parser = range, allow_hyphen_values = true)]
    limit_switches: Option<(i64, i64)>,
    /// Home switch: active from FROM to TO
    #[arg(long, value_name = "FROM..TO", value_parser = range, allow_hyphen_values = true)]
    home_switch: Option<(i64, i64)>,
    /// The input of touch probe 1: active from FIRST to LAST
    #[arg(long, value_name = "FIRST..LAST", value_parser = range, allow_hyphen_values = true)]
    probe: Option<(i64, i64)>,
    /// Counts from one index pulse to the next, one of them at 0; without it there are none
    #[arg(long, value_name = "COUNTS", default_value_t = 0)]
    index_period: u32,
    /// The encoders know their position at power-up
    #[arg(long)]
    absolute_encoder: bool,
}

impl MachineArguments {
    pub(crate) fn machine(&self) -> Machine {
        Machine {
            start: self.stands_at,
            negative_limit: self.limit_switches.map(|(low, _)| low),
            positive_limit: self.limit_switches.map(|(_, high)| high),
            home_switch: self.home_switch,
            index_period: self.index_period,
            probes: [self.probe.map(|(first, last)| Mark::new(first, last)), None],
            absolute_encoder: self.absolute_encoder,
            ..Machine::default()
        }
    }
}

/// Two positions, the first not above the second.
fn range(text: &str) -> Result<(i64, i64), String> {
    let positions = text.split_once("..").and_then(|(from, to)| {
        let from: i64 = from.parse().ok()?;
        let to: i64 = to.parse().ok()?;
        Some((from, to))
    });
    match positions {
        None => Err("it is not two positions such as -500..20000".into()),
        Some((from, to)) if from > to => Err(format!(
            "the first position is above the second: the lower one comes first, such as {to}..{from}"
        )),
        Some(positions) => Ok(positions),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        machine: MachineArguments,
    }

    fn parse(arguments: &[&str]) -> Result<Machine, clap::Error> {
        let all = ["program"].iter().chain(arguments);
        Program::try_parse_from(all).map(|program| program.machine.machine())
    }

    #[test]
    fn without_options_the_machine_has_nothing() {
        assert_eq!(parse(&[]).unwrap(), Machine::default());
    }

    #[test]
    fn every_option_finds_its_place() {
        let machine = parse(&[
            "--stands-at",
            "-700",
            "--limit-switches",
            "-50000..60000",
            "--home-switch=10..20",
            "--probe=-30..40",
            "--index-period",
            "4096",
            "--absolute-encoder",
        ]);
        let expected = Machine {
            start: -700,
            negative_limit: Some(-50_000),
            positive_limit: Some(60_000),
            home_switch: Some((10, 20)),
            index_period: 4096,
            probes: [Some(Mark::new(-30, 40)), None],
            absolute_encoder: true,
            ..Machine::default()
        };
        assert_eq!(machine.unwrap(), expected);
    }

    #[test]
    fn what_is_no_range_is_refused_with_an_example() {
        for text in ["", "5", "1..", "..2", "a..b"] {
            let error = parse(&["--home-switch", text]).unwrap_err().to_string();
            assert!(error.contains("-500..20000"), "{error}");
        }
    }

    #[test]
    fn a_range_whose_first_position_is_above_the_second_is_refused_with_the_reason() {
        let error = parse(&["--limit-switches", "5..-5"]).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("the lower one comes first, such as -5..5"),
            "{error}"
        );
    }
}
