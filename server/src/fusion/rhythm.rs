//! When snapshots are published: at steady ticks and, where that is wanted, as soon as a frame has been fused.

use std::time::{Duration, Instant};

/// From one prompt snapshot to the next at least, however many frames come: 1000 a second, as at the highest steady rate.
const LEAST_PERIOD: Duration = Duration::from_millis(1);

/// When the next snapshot is due.
#[derive(Clone, Copy, Debug)]
pub struct Rhythm {
    period: Duration,
    is_prompt: bool,
    tick: Instant,
    /// When the newest one between ticks was published.
    prompted: Instant,
}

impl Rhythm {
    /// Steady ticks from now on; a prompt one has snapshots between them, each as soon as there is news.
    pub fn new(period: Duration, is_prompt: bool) -> Self {
        let now = Instant::now();
        Self { period, is_prompt, tick: now + period, prompted: now }
    }

    /// The next steady one.
    pub fn tick(&self) -> Instant {
        self.tick
    }

    /// When the next snapshot is due, by whether there has been news since the one before.
    pub fn due(&self, has_news: bool) -> Instant {
        if self.is_prompt && has_news {
            self.tick.min(self.prompted + LEAST_PERIOD)
        } else {
            self.tick
        }
    }

    /// To which instant the snapshot is predicted that is published `now`.
    pub fn pose_time(&self, now: Instant) -> Instant {
        if self.is_prompt { self.tick.min(now) } else { self.tick }
    }

    /// Notes that a snapshot was begun and published. After a stall missed ticks are left out instead of being caught
    /// up in a burst.
    pub fn publish(&mut self, begun: Instant, published: Instant) {
        if self.pose_time(begun) != self.tick {
            self.prompted = begun;
            return;
        }
        self.tick += self.period;
        while self.tick <= published {
            self.tick += self.period;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(16);

    #[test]
    fn steady_ones_wait_for_their_tick_whatever_comes() {
        let mut rhythm = Rhythm::new(PERIOD, false);
        let first = rhythm.tick();
        assert_eq!([rhythm.due(true), rhythm.due(false)], [first; 2]);
        let late = first + Duration::from_millis(1);
        assert_eq!(rhythm.pose_time(late), first);
        rhythm.publish(late, late);
        assert_eq!(rhythm.tick(), first + PERIOD);
        // Two were missed.
        rhythm.publish(first + PERIOD, first + 3 * PERIOD + Duration::from_millis(2));
        assert_eq!(rhythm.tick(), first + 4 * PERIOD);
    }

    #[test]
    fn prompt_ones_follow_news_and_leave_the_ticks_where_they_are() {
        let mut rhythm = Rhythm::new(PERIOD, true);
        let first = rhythm.tick();
        let news = first - Duration::from_millis(9);
        assert_eq!(rhythm.due(false), first);
        assert!(rhythm.due(true) < news, "nothing was published for long");
        assert_eq!(rhythm.pose_time(news), news);
        rhythm.publish(news, news + Duration::from_micros(200));
        assert_eq!(rhythm.tick(), first);
        // More news at once has to wait a little, and never beyond the tick.
        assert_eq!(rhythm.due(true), news + LEAST_PERIOD);
        let again = first - Duration::from_micros(300);
        rhythm.publish(again, again);
        assert_eq!(rhythm.due(true), first);
        rhythm.publish(first, first);
        assert_eq!(rhythm.tick(), first + PERIOD);
        // A steady one makes no news wait.
        let next = first + PERIOD;
        rhythm.publish(next, next);
        assert!(rhythm.due(true) < next);
    }
}
