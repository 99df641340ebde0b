//! What a scenario asks for in vain: no error, and yet nobody means it.

use super::{Nanos, Scenario, When};

impl Scenario {
    /// One line each for scheduled swaps and injected faults that lie beyond the end of the run.
    #[must_use]
    pub fn in_vain(&self) -> Vec<String> {
        let (period_ns, end) = (self.period_ns(), self.end_tick_at_most());
        let run = Nanos(end.saturating_mul(period_ns));
        let beyond = |key: &str, at: When| {
            let reached = at.tick(period_ns) < end;
            (!reached).then(|| format!("{key}.at = {at}: the run ends before that, after {run} ({end} ticks)"))
        };
        let swaps = self.swap.iter().enumerate().filter_map(|(index, swap)| {
            let key = format!("swap[{index}]");
            beyond(&key, swap.at).or_else(|| {
                let blend = swap.blend.unwrap_or(self.swap_gate.blend);
                let ended = swap.at.tick(period_ns).saturating_add(blend.ns().div_ceil(period_ns)) <= end;
                (!ended).then(|| format!("{key}.blend = {blend}: the run ends before the cross-fade does, after {run}"))
            })
        });
        let faults = self.fault.iter().enumerate();
        let faults = faults.filter_map(|(index, fault)| beyond(&format!("fault[{index}]"), fault.at?));
        swaps.chain(faults).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn in_vain(text: &str) -> Vec<String> {
        Scenario::from_toml(&format!("[loop]\nduration = \"2s\"\n{text}"), "test").unwrap().in_vain()
    }

    #[test]
    fn what_lies_beyond_the_end_of_the_run_is_named_and_what_does_not_is_not() {
        let swap = |rest: &str| format!("[[swap]]\nlaw = \"ctc\"\n{rest}\n");
        let fault = |rest: &str| format!("[[fault]]\nkind = \"drop\"\n{rest}\n");
        for good in [swap("at = 1999"), swap("at = 1980\nblend = \"20ms\""), fault("at = 1999"), fault("every = 5")] {
            assert_eq!(in_vain(&good), Vec::<String>::new(), "{good}");
        }
        for (bad, named) in [
            (swap("at = 2000"), "swap[0].at = 2000"),
            (swap("at = \"20s\""), "swap[0].at = 20s"),
            (swap("at = 1990\nblend = \"20ms\""), "swap[0].blend = 20ms"),
            (fault("at = \"3s\""), "fault[0].at = 3s"),
        ] {
            let lines = in_vain(&bad);
            assert!(lines.len() == 1 && lines[0].contains(named) && lines[0].contains("2s"), "{lines:?}");
        }
    }

    #[test]
    fn a_run_that_may_be_prolonged_ends_when_it_was_prolonged_for_the_last_time() {
        let swap = |at: u64| format!("[expect]\nmissed_ticks = \"== 0\"\n[[swap]]\nlaw = \"ctc\"\nat = {at}\n");
        assert_eq!(in_vain(&swap(5999)), Vec::<String>::new());
        assert_eq!(in_vain(&swap(6000)).len(), 1);
    }
}
