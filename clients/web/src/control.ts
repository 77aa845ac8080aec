// Commands cars and paints them anew through `crumple view --control`. If the gateway or the server refuses, the functions throw an
// Error with the sentence.
import { Builder, ByteBuffer } from "flatbuffers";
import { Answer } from "./crumple/schema/answer.js";
import { Command } from "./crumple/schema/command.js";
import { Despawn } from "./crumple/schema/despawn.js";
import { Order } from "./crumple/schema/order.js";
import { Parameters } from "./crumple/schema/parameters.js";
import { Pose as PoseStruct } from "./crumple/schema/pose.js";
import { Repair } from "./crumple/schema/repair.js";
import { Replace } from "./crumple/schema/replace.js";
import { Spawn } from "./crumple/schema/spawn.js";
import type { Pose } from "./decode.js";

/** A field of Parameters (schema/message.fbs) with the range that the server allows. */
export interface Parameter {
  name: string;
  low: number;
  high: number;
  standard: number;
  unit: string;
  /** Each region has its own value; otherwise the car has one. */
  ofRegion: boolean;
  whole: boolean;
}

/** One entry of `parameters` in a preset (schema/scene.fbs); solver: "nodal" or "classic". */
export type Changes = { region?: number; solver?: string } & { [name: string]: number | string | undefined };

const solvers = ["nodal", "classic"];

export class Control {
  private constructor(readonly parameters: Parameter[], readonly url: URL) {}

  /** url: of the page of a gateway. null: this gateway takes no commands. */
  static async find(url: string | URL): Promise<Control | null> {
    const answer = await fetch(new URL("parameters", url));
    if (!answer.ok) return null;
    const { control, parameters } = (await answer.json()) as { control: boolean; parameters: Parameter[] };
    return control ? new Control(parameters, new URL(url)) : null;
  }

  /** Changes all of these parameters, or none. */
  change(car: string, changes: Changes): Promise<void> {
    return this.#command(car, Order.Parameters, (builder) => {
      Parameters.startParameters(builder);
      for (const [name, value] of Object.entries(changes)) {
        if (name === "solver") Parameters.addSolver(builder, solvers.indexOf(`${value}`));
        else this.#add(builder, name, Number(value));
      }
      return Parameters.endParameters(builder);
    });
  }

  repair(car: string, amount = 1): Promise<void> {
    return this.#command(car, Order.Repair, (builder) => Repair.createRepair(builder, amount));
  }

  despawn(car: string): Promise<void> {
    return this.#command(car, Order.Despawn, Despawn.createDespawn);
  }

  spawn(car: string, asset: string, host: string, { position: p, orientation: q }: Pose): Promise<void> {
    return this.#command(car, Order.Spawn, (builder) => {
      const [assetText, hostText] = [builder.createString(asset), builder.createString(host)];
      Spawn.startSpawn(builder);
      Spawn.addAsset(builder, assetText);
      Spawn.addHost(builder, hostText);
      Spawn.addPose(builder, PoseStruct.createPose(builder, p[0], p[1], p[2], q[0], q[1], q[2], q[3]));
      return Spawn.endSpawn(builder);
    });
  }

  /** Makes the car another asset, undamaged; its host, mass, parameters and motion stay. */
  replace(car: string, asset: string): Promise<void> {
    return this.#command(car, Order.Replace, (builder) => Replace.createReplace(builder, builder.createString(asset)));
  }

  /** Gives the baked car painted anew, which the scene's server then has too. regions: JSON of schema/regions.fbs. */
  async paint(asset: string, regions: string): Promise<Uint8Array> {
    return this.#post(`paint/${asset}`, regions);
  }

  #add(builder: Builder, name: string, value: number): void {
    const setter = `add${name.replace(/(^|_)(.)/g, (_, __, letter: string) => letter.toUpperCase())}`;
    const add = (Parameters as unknown as Record<string, (builder: Builder, value: number) => void>)[setter];
    if (!add) throw new Error(`there is no parameter ${name}`);
    add(builder, value);
  }

  async #command(car: string, kind: Order, order: (builder: Builder) => number): Promise<void> {
    const builder = new Builder();
    builder.finish(Command.createCommand(builder, kind, order(builder)));
    const answer = Answer.getRootAsAnswer(new ByteBuffer(await this.#post(`command/car/${car}`, builder.asUint8Array().slice())));
    if (!answer.ok()) throw new Error(answer.sentence() ?? "refused");
  }

  async #post(path: string, body: string | Uint8Array<ArrayBuffer>): Promise<Uint8Array> {
    const answer = await fetch(new URL(path, this.url), { method: "POST", body });
    if (!answer.ok) throw new Error((await answer.text()).trim() || `the gateway answers ${answer.status}`);
    return new Uint8Array(await answer.arrayBuffer());
  }
}
