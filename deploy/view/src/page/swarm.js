// The swarm as the server describes it in `hello`: who its vehicles are, what they fly. It does not change in flight.

/** Swarms with more vehicles are drawn as points; details are asked of those in view. */
export const LARGE = 100;

export class Swarm {
  constructor(hello) {
    this.name = hello.swarm ?? "swarm";
    this.title = hello.title ?? this.name;
    this.isLive = hello.source !== "recording";
    this.hasOrders = hello.orders === true;
    this.needsToken = hello.needs_token === true;
    this.from_s = hello.from_s ?? 0;
    this.to_s = hello.to_s ?? null;
    this.duration_s = hello.duration_s ?? null;
    this.vehicles = Array.isArray(hello.vehicles) ? hello.vehicles : [];
    this.ids = this.vehicles.map(({ id }) => String(id));
    this.index = new Map(this.ids.map((id, at) => [id, at]));
    this.isLarge = this.vehicles.length > LARGE;
    /** Facts of a vehicle that its card shows as a number: key, name, meaning, factor, decimals, unit. */
    this.facts = Array.isArray(hello.facts) ? hello.facts : [];
    this.scenario = hello.scenario ?? {};
    this.steps = this.scenario.steps ?? [];
    this.readTeams(hello);
    this.readLimits();
  }

  readTeams(hello) {
    const numbers = [...new Set(this.vehicles.map(({ team }) => team ?? 0))];
    const described = new Map((hello.teams ?? []).map((team) => [team.id, team]));
    const place = new Map(numbers.map((number, at) => [number, at]));
    /** Teams in the order of their first vehicle; one for a swarm without teams. */
    this.teams = numbers.map((id) => ({
      id,
      name: described.get(id)?.name ?? null,
      steps: described.get(id)?.scenario?.steps ?? this.steps,
      members: [],
    }));
    this.teamIndex = Uint16Array.from(this.vehicles, ({ team }) => place.get(team ?? 0));
    this.teamIndex.forEach((team, vehicle) => this.teams[team].members.push(vehicle));
  }

  readLimits() {
    const { network, safety_distance_m, collision_distance_m, even } = this.scenario;
    this.stale_ms = 1000 * (network?.stale_s ?? 0.5);
    this.lost_ms = 1000 * (network?.lost_s ?? 2);
    this.safety_m = safety_distance_m ?? null;
    this.collision_m = collision_distance_m ?? 2;
    this.hasGaps = even === true;
  }

  /** The formation of a team at this step; of the last step that has one, if this step has none (landing). */
  formation(team, step) {
    const { steps } = this.teams[team] ?? { steps: this.steps };
    for (let at = Math.min(step ?? 0, steps.length - 1); at >= 0; at -= 1) {
      if (steps[at].formation) return steps[at].formation;
    }
    return this.scenario.formation ?? null;
  }

  /** Name of a step: `2 gate`. */
  stepName(step, team = 0) {
    const steps = this.teams[team]?.steps ?? this.steps;
    const name = steps[step]?.name ?? { land: "land", hold: "hold", path: "path" }[steps[step]?.kind];
    return name ? `${step} ${name}` : `step ${step}`;
  }

  /** Whether this description and another are of the same flight, so that what was seen before stays valid. */
  isSameAs(other) {
    return this.isLive && other.isLive && this.name === other.name && this.ids.join() === other.ids.join();
  }
}
