import sys
sys.path.insert(0,'/tmp/w/docs')
from pathlib import Path
from datetime import datetime, UTC
import arpd.daemon.scenario as sc
from arpd.daemon.tick import Daemon as D
from arpd.host.config.load import load_settings
from arpd.sim.robot import configured_topics
from arpd.sim.schedule import RateSchedule
from arpd.sim.link import LinkModel
import inspect
def tell(e): print(datetime.fromtimestamp(e.unix_time_s,UTC).strftime('%H:%M:%S'), e.kind, e.text, flush=True)
def make(*a,**k): return D(*a,tell=tell,**k)
sc.Daemon=make
print(inspect.signature(sc.__dict__.get('run_scenario', lambda:0)), [n for n in dir(sc) if not n.startswith('__')])
settings=load_settings(Path('/tmp/w/docs/scripts/robot/arpd.yaml'),interfaces=None)
topics=configured_topics(settings,actuation=['/cmd_vel'])
sc.run(settings,RateSchedule.parse(sys.argv[1]),float(sys.argv[2]),seed=1,managed=True,topics=topics,model=LinkModel(pushes_back=True))
